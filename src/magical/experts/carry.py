"""Carrying a held block to its goal: forwards, backwards or turning, whichever is soonest.

All short motions are scored by about how many control steps remain until the block is at its goal.
The best few of each first action are also charged for walls and blocks on their paths, and the
first action of the cheapest is taken.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magical.experts.array_geometry import Floats, Ints, excess, lengths, wrap_angles
from magical.experts.distances import BLOCK_SPACING, CONTACT_DISTANCE, HELD_DISTANCE, ROBOT_LIMIT
from magical.experts.motions import (
    DRIVE_STEP,
    OPEN_ACTIONS,
    TURN_STEP,
    MotionTable,
    motion_table,
)
from magical.experts.paths import next_waypoint
from magical.experts.state_view import StateView
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.geometry import Point


@dataclass(frozen=True, slots=True)
class CarrySettings:
    """What the rest of a motion is charged for."""

    waypoint_clearance: float = 0.31  # units from the block to obstacles on its path; tuned
    waypoint_tolerance: float = 0.1  # units: how exactly waypoints are met; tuned
    goal_tolerance: float = 0.7  # share of a move's tolerance that is aimed at; tuned
    detour: float = 1.3  # of the straight line's time that the rest takes; tuned
    pull_turn: float = 0.6  # rad that pulling costs in addition to facing away; tuned
    turn_limit: float = 40.0  # control steps per unit: short ways need no facing; tuned
    correction: float = 4.0  # control steps that any further correction takes; tuned
    stop_cost: float = 4.0  # control steps added to standing still, which could last; tuned
    candidates: int = 5  # motions of each first action that are checked for obstacles; for time


@dataclass(frozen=True, slots=True)
class CarryRoom:
    """The room that a motion with a block should leave."""

    block_limit: float = 0.84  # units: largest coordinate of the held block's centre; tuned
    cost: float = 45.0  # control steps per unit of missing room; tuned
    rear: float = 0.18  # units behind the robot that should be free at the end; tuned
    rear_wall_cost: float = 5.0  # of `cost`: of a wall there, which prevents release; tuned
    block_wall_cost: float = 2.0  # of `cost`: of a wall at the block; tuned


@dataclass(frozen=True, slots=True)
class GripSettings:
    """How fingers close around a block."""

    steps: int = 2  # control steps of closing before a block is carried; measured
    closed_opening: float = 0.33  # rad: smaller openings hold a block already; measured
    advance: float = 0.015  # units beyond HELD_DISTANCE at which the robot still drives up; tuned


CARRY = CarrySettings()
ROOM = CarryRoom()
GRIP = GripSettings()

_ROW_STARTS = np.arange(OPEN_ACTIONS)[:, None]
_TO_CLOSED = Action(gripper=Gripper.CLOSED).id  # added to an action's id: with closed fingers


def grip(view: StateView, block: Point) -> int:
    """The action that closes the fingers around a block, moving up to it."""
    is_ahead = view.to_robot_frame(block)[1] > HELD_DISTANCE + GRIP.advance
    drive = Longitudinal.FORWARD if is_ahead else Longitudinal.STOP
    return Action(drive, Turn.STRAIGHT, Gripper.CLOSED).id


def is_gripped(view: StateView, held_steps: int) -> bool:
    """Whether the fingers have closed on a block that has been between them for `held_steps`."""
    return held_steps >= GRIP.steps or view.finger_opening <= GRIP.closed_opening


def carry(
    view: StateView, block: Point, goal: Point, tolerance: float, others: Sequence[Point]
) -> int:
    """The action that moves a block between closed fingers towards its goal."""
    point = next_waypoint(block, goal, others, CARRY.waypoint_clearance, view.angle)
    table = motion_table(view.speed, view.spin)
    near = tolerance if point == goal else CARRY.waypoint_tolerance
    remaining = _remaining_steps(
        table, view.to_robot_frame(block), view.to_robot_frame(point), near
    )
    return _TO_CLOSED + _cheapest_action(view, table, table.time + remaining, others)


def _remaining_steps(table: MotionTable, block: Point, goal: Point, tolerance: float) -> Floats:
    """About how many control steps (N,) the held block needs to the goal after each motion."""
    end = table.robot[:, -1] + block[0] * table.right + block[1] * table.ahead
    offset = np.array(goal) - end  # (N, 2)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    angle = np.abs(wrap_angles(np.arctan2(-offset[:, 0], offset[:, 1]) - table.turned))
    turn = np.minimum(angle, CARRY.pull_turn + math.pi - angle) / TURN_STEP
    missing = np.maximum(0.0, distance - CARRY.goal_tolerance * tolerance)
    steps: Floats = CARRY.detour * missing / DRIVE_STEP
    steps += np.minimum(turn, CARRY.turn_limit * missing) + CARRY.correction * (missing > 0)
    return steps


def _cheapest_action(
    view: StateView, table: MotionTable, cost: Floats, others: Sequence[Point]
) -> int:
    """The first action of the cheapest motion once walls and blocks on its path are charged."""
    rows = cost.reshape(OPEN_ACTIONS, -1)  # one for each first action
    rows[0] += CARRY.stop_cost
    best = np.argpartition(rows, CARRY.candidates, axis=1)[:, : CARRY.candidates]
    candidates = (best + _ROW_STARTS * rows.shape[1]).ravel()
    total = cost[candidates] + ROOM.cost * _missing_room(view, table, candidates, others)
    return int(table.first[candidates[total.argmin()]])


def _missing_room(
    view: StateView, table: MotionTable, motions: Ints, others: Sequence[Point]
) -> Floats:
    """Units (P,) by which each motion gets too close to walls and other blocks on its path."""
    rotation = np.array(((view.cos, view.sin), (-view.sin, view.cos)))
    here = np.array(view.position)
    robot = table.robot[motions] @ rotation + here  # (P, K, 2)
    block = table.block[motions] @ rotation + here
    # Room to back off once the block is released, as if the path went on backwards.
    rear = table.robot[motions, -1:] - ROOM.rear * table.ahead[motions, None]  # (P, 1, 2)
    rear = rear @ rotation + here
    robot = np.concatenate((robot, rear), axis=1)
    missing: Floats = excess(robot, ROBOT_LIMIT).max(axis=(1, 2))
    missing += ROOM.rear_wall_cost * excess(rear, ROBOT_LIMIT).max(axis=(1, 2))
    at_walls = excess(block, ROOM.block_limit).sum(axis=2).mean(axis=1)
    missing += ROOM.block_wall_cost * at_walls
    if others:
        points = np.array(others)
        missing += _intrusion(robot, points, CONTACT_DISTANCE)
        missing += _intrusion(block, points, BLOCK_SPACING)
    return missing


def _intrusion(paths: Floats, points: Floats, room: float) -> Floats:
    """Units (P,) by which paths (P, K, 2) get closer than `room` to points (M, 2), in all."""
    offset = paths[:, :, None] - points
    distance = lengths(offset)  # (P, K, M)
    missing: Floats = np.maximum(0.0, room - distance.min(axis=1)).sum(axis=1)
    return missing
