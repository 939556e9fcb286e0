"""Carrying a held block to its goal: forwards, backwards or turning, whichever is quickest.

A motion is a pair of actions, each repeated for a few control steps. All motions are rolled out
under a model that knows how fast top speeds are reached, but nothing about contacts. At every
control step, all motions are scored by the approximate number of control steps until the block is
at its goal. The best few for each first action are also charged for walls and blocks on their
paths, and the first action of the cheapest motion is taken.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from magical.experts import geometry as g
from magical.experts.geometry import Floats, Ints
from magical.experts.paths import next_waypoint
from magical.experts.state_view import StateView
from magical.scene import NUM_ACTIONS, Action, Gripper, Longitudinal, Point, Turn, lengths
from magical.scene.constants import CONTROL_RATE

GRIP_STEPS = 2  # control steps of closing before a block is carried; measured
GRIPPED_OPENING = 0.33  # rad: smaller openings already hold a block; measured
GRIP_ADVANCE = 0.015  # units beyond g.HELD_DISTANCE from which the robot still drives up; tuned

WAYPOINT_CLEARANCE = 0.31  # units from the block to obstacles on its path; tuned
WAYPOINT_TOLERANCE = 0.1  # units: how exactly waypoints are met; tuned
GOAL_TOLERANCE = 0.7  # share of a move's tolerance to aim for; tuned
REST_DETOUR = 1.3  # factor on the straight-line time of the remaining way; tuned
PULL_TURN = 0.6  # rad that pulling costs in addition to facing away; tuned
TURN_LIMIT = 40.0  # control steps per unit: limits the turn before a short way; tuned
CORRECTION_STEPS = 4.0  # control steps that any further correction takes; tuned
STOP_COST = 4.0  # control steps added to standing still, which might never end; tuned
CANDIDATES = 5  # motions per first action that are checked for obstacles; for time

BLOCK_LIMIT = 0.84  # units: largest coordinate of the held block's centre; tuned
ROOM_COST = 45.0  # control steps per unit of missing room; tuned
REAR = 0.18  # units behind the robot that should be free at the end; tuned
REAR_WALL_FACTOR = 5.0  # times `ROOM_COST`: for a wall there, which prevents release; tuned
BLOCK_WALL_FACTOR = 2.0  # times `ROOM_COST`: for a wall at the block; tuned

# How robot and held block accelerate, fitted by hand to the simulator. A test compares the two over
# five steps of one action.
DRIVE_CHANGE = 0.028  # units: change in velocity per step due to the drive; measured
DRAG_CHANGE = 0.0145  # units: change in velocity per step due to the block's friction; measured
SPIN_UP = 0.085  # rad: change in spin per step; measured
SPIN_STOP = 0.33  # share of the current spin still turned on stopping; measured
PIVOT = 0.06  # units ahead of the robot's centre about which both turn; measured

# Which motions are rolled out, and from which initial speeds. Tuned for time and scores.
FIRST_STEPS = (1, 2, 3, 5)  # control steps of a motion's first action
SECOND_STEPS = (0, 1, 2, 4)  # and of its second action
STRIDE = 2  # control steps between the points of a path that are kept
SPEEDS = (-0.06, 0.0, 0.05, 0.1)  # units per control step
SPINS = (-0.25, 0.0, 0.25)  # rad per control step

OPEN_ACTIONS = NUM_ACTIONS // 2  # with open fingers; those with closed ones follow in this order
_ROW_STARTS = np.arange(OPEN_ACTIONS)[:, None]
_TO_CLOSED = Action(gripper=Gripper.CLOSED).id  # added to an action's id: closes the fingers


class MotionTable(NamedTuple):
    """N motions in the robot's initial frame, with K points on each path."""

    first: Ints  # (N,) ids of the first actions, fingers open, in ascending order
    time: Floats  # (N,) control steps
    robot: Floats  # (N, K, 2) path of the robot's centre; the last point is the end
    block: Floats  # (N, K, 2) path of a held block
    turned: Floats  # (N,) rad
    ahead: Floats  # (N, 2) unit vector ahead at the end
    right: Floats  # (N, 2) and to the right


def carry(
    view: StateView,
    block: Point,
    goal: Point,
    tolerance: float,
    others: Sequence[Point],
    held_steps: int = GRIP_STEPS,
) -> int:
    """The action that closes the fingers on the block between them, and then moves it to its goal.

    The block has been between the fingers for `held_steps` control steps.
    """
    local = view.to_robot_frame(block)
    if held_steps < GRIP_STEPS and view.finger_opening > GRIPPED_OPENING:
        is_ahead = local[1] > g.HELD_DISTANCE + GRIP_ADVANCE
        drive = Longitudinal.FORWARD if is_ahead else Longitudinal.STOP
        return Action(drive, Turn.STRAIGHT, Gripper.CLOSED).id
    point = next_waypoint(block, goal, others, WAYPOINT_CLEARANCE, view.angle)
    table = motion_table(view.speed, view.spin)
    near = tolerance if point == goal else WAYPOINT_TOLERANCE
    steps = table.time + _remaining_steps(table, local, view.to_robot_frame(point), near)
    return _TO_CLOSED + _cheapest_action(view, table, steps, others)


def _remaining_steps(table: MotionTable, block: Point, goal: Point, tolerance: float) -> Floats:
    """Approximate control steps (N,) from the end of each motion until the block is at the goal."""
    end = table.robot[:, -1] + block[0] * table.right + block[1] * table.ahead
    offset = np.array(goal) - end  # (N, 2)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    angle = np.abs(g.wrap_angle(np.arctan2(-offset[:, 0], offset[:, 1]) - table.turned))
    turn = np.minimum(angle, PULL_TURN + math.pi - angle) / g.TURN_STEP
    missing = np.maximum(0.0, distance - GOAL_TOLERANCE * tolerance)
    steps: Floats = REST_DETOUR * missing / g.DRIVE_STEP
    steps += np.minimum(turn, TURN_LIMIT * missing) + CORRECTION_STEPS * (missing > 0)
    return steps


def _cheapest_action(
    view: StateView, table: MotionTable, cost: Floats, others: Sequence[Point]
) -> int:
    """The first action of the cheapest motion once walls and blocks on its path are charged."""
    rows = cost.reshape(OPEN_ACTIONS, -1)  # one for each first action
    rows[0] += STOP_COST
    best = np.argpartition(rows, CANDIDATES, axis=1)[:, :CANDIDATES]
    candidates = (best + _ROW_STARTS * rows.shape[1]).ravel()
    total = cost[candidates] + ROOM_COST * _missing_room(view, table, candidates, others)
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
    rear = table.robot[motions, -1:] - REAR * table.ahead[motions, None]  # (P, 1, 2)
    rear = rear @ rotation + here
    robot = np.concatenate((robot, rear), axis=1)
    missing: Floats = g.excess(robot, g.ROBOT_LIMIT).max(axis=(1, 2))
    missing += REAR_WALL_FACTOR * g.excess(rear, g.ROBOT_LIMIT).max(axis=(1, 2))
    missing += BLOCK_WALL_FACTOR * g.excess(block, BLOCK_LIMIT).sum(axis=2).mean(axis=1)
    if others:
        points = np.array(others)
        missing += _intrusion(robot, points, g.CONTACT_DISTANCE)
        missing += _intrusion(block, points, g.BLOCK_SPACING)
    return missing


def _intrusion(paths: Floats, points: Floats, room: float) -> Floats:
    """Units (P,) by which paths (P, K, 2) get closer than `room` to points (M, 2), in total."""
    distance = lengths(paths[:, :, None] - points)  # (P, K, M)
    missing: Floats = np.maximum(0.0, room - distance.min(axis=1)).sum(axis=1)
    return missing


def motion_table(speed: float, spin: float) -> MotionTable:
    """The motions from the initial speed (units / s) and spin (rad / s) nearest to those given."""
    return _table(
        min(SPEEDS, key=lambda each: abs(each - speed / CONTROL_RATE)),
        min(SPINS, key=lambda each: abs(each - spin / CONTROL_RATE)),
    )


@cache
def _table(speed: float, spin: float) -> MotionTable:
    sequences = [
        [first] * n + [second] * m
        for first in range(OPEN_ACTIONS)
        for n in FIRST_STEPS
        for second in range(OPEN_ACTIONS)
        for m in SECOND_STEPS
        if (first != second) == (m > 0)
    ]
    longest = max(map(len, sequences)) + 1  # one step more to come to rest
    actions = np.array([ids + [0] * (longest - len(ids)) for ids in sequences])  # (N, T)
    time = np.array([len(ids) for ids in sequences], dtype=np.float64)
    centres, angles = _roll_out(actions, speed, spin)
    ahead = _ahead(angles)  # (N, K, 2)
    right = np.stack((ahead[..., 1], -ahead[..., 0]), axis=-1)
    end = angles[:, -1], ahead[:, -1], right[:, -1]
    return MotionTable(actions[:, 0], time, centres, centres + g.HELD_DISTANCE * ahead, *end)


def _roll_out(actions: Ints, speed: float, spin: float) -> tuple[Floats, Floats]:
    """Centres (N, K, 2) and angles (N, K) on the paths of action sequences (N, T)."""
    aims = np.array([0.0, g.DRIVE_STEP, -g.BACK_STEP])[actions % 3]
    turn_aims = np.array([0.0, g.TURN_STEP, -g.TURN_STEP])[actions // 3 % 3]
    spins, angle = np.full(len(actions), spin), np.zeros(len(actions))
    centre, velocity = np.zeros((len(actions), 2)), np.zeros((len(actions), 2))
    velocity[:, 1] = speed
    centres, angles = [], []
    for step in range(actions.shape[1]):
        turn, spins = _turn(spins, turn_aims[:, step])
        before, middle, after = (_ahead(angle + share * turn) for share in (0.0, 0.5, 1.0))
        faster = _accelerate(velocity, aims[:, step, None] * middle)
        centre = centre + 0.5 * (velocity + faster) + PIVOT * (before - after)
        angle, velocity = angle + turn, faster
        if step % STRIDE == STRIDE - 1 or step == actions.shape[1] - 1:
            centres.append(centre)
            angles.append(angle)
    return np.stack(centres, axis=1), np.stack(angles, axis=1)


def _accelerate(velocity: Floats, aim: Floats) -> Floats:
    """The velocity (N, 2) after a step of the drive towards `aim` and of the block's friction."""
    wanted = aim + _capped_share(aim, DRAG_CHANGE) * aim - velocity
    driven = velocity + _capped_share(wanted, DRIVE_CHANGE) * wanted
    return driven * (1.0 - _capped_share(driven, DRAG_CHANGE))


def _capped_share(vector: Floats, limit: float) -> Floats:
    """The factors (N, 1) that cap the length of vectors (N, 2)."""
    length = np.hypot(vector[:, :1], vector[:, 1:])
    return np.minimum(1.0, limit / np.maximum(length, 1e-9))


def _ahead(angle: Floats) -> Floats:
    return np.stack((-np.sin(angle), np.cos(angle)), axis=-1)


def _turn(spin: Floats, aim: Floats) -> tuple[Floats, Floats]:
    """The angle turned in a control step, and the spin after it."""
    increased = spin + np.clip(aim - spin, -SPIN_UP, SPIN_UP)
    reversed_ = aim * spin < 0
    after = np.where(reversed_, 0.5 * aim, np.where(aim == 0, 0.0, increased))
    stopping = reversed_ | (aim == 0)
    turned = np.where(stopping, SPIN_STOP * spin, 0.375 * spin + 0.625 * increased)
    return turned, after
