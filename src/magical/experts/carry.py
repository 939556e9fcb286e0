"""Bringing a held block to its place: forwards, backwards or turning, whichever is soonest.

All short motions are scored by the control steps, about, until the block would be there after
them; to the best are added what walls and blocks in the way cost, and the cheapest one's first
action is taken.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magical.experts.motions import ACTIONS_TRIED, HOLD, STEP, TAP, Floats, Table, table_for
from magical.experts.paths import next_waypoint
from magical.experts.sight import Sight
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.geometry import Point

BODY_ROOM = 0.31  # units from the robot's centre to a block's
BLOCK_ROOM = 0.26  # units between two blocks' centres
REAR = 0.18  # units behind the robot that should be free in the end
CORNERED = 5.0  # how much worse it is if a wall is there
BODY_LIMIT, BLOCK_LIMIT = 0.8, 0.84  # largest coordinates of the robot's and the block's centre
CLEARANCE = 0.31  # units from a carried block's centre to an obstacle's when planning ways
_BLAME = 45.0  # control steps, per unit, that getting too close costs: two blocks are hard to push
_MORE = 4.0  # control steps that any further correction takes
_IDLE = 4.0  # control steps that standing still seems to cost
_TOP = 5  # motions, for each first action, that are checked for obstacles
_ROW_STARTS = np.arange(ACTIONS_TRIED)[:, None]
_CLOSED = 9  # added to an action's id: the same with closed fingers


def carry(
    sight: Sight, block: Point, goal: Point, tolerance: float, others: Sequence[Point]
) -> int:
    """Move on with the block between closed fingers."""
    point = next_waypoint(block, goal, others, CLEARANCE, sight.angle)
    table = table_for(sight.speed, sight.spin)
    near = tolerance if point == goal else 0.1
    cost = table.time + _to_place(table, sight.local(block), sight.local(point), near)
    return _CLOSED + _pick(sight, table, cost, others)


def grip(sight: Sight, block: Point) -> int:
    """Close the fingers around a block between them, moving up to it."""
    forward = Longitudinal.FORWARD if sight.local(block)[1] > HOLD + 0.015 else Longitudinal.STOP
    return Action(forward, Turn.STRAIGHT, Gripper.CLOSED).id


def _to_place(table: Table, block: Point, goal: Point, tolerance: float) -> Floats:
    """Control steps, about, from the end of each motion until the held block is at the goal."""
    end = table.robot[:, -1] + block[0] * table.right + block[1] * table.ahead
    offset = np.array(goal) - end  # (N, 2)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    angle = np.abs(_wrap(np.arctan2(-offset[:, 0], offset[:, 1]) - table.turned))
    turn = np.minimum(angle, 0.6 + math.pi - angle) / TAP
    missing = np.maximum(0.0, distance - 0.7 * tolerance)
    to_go: Floats = 1.3 * missing / STEP + np.minimum(turn, 40.0 * missing) + _MORE * (missing > 0)
    return to_go


def _pick(sight: Sight, table: Table, cost: Floats, others: Sequence[Point]) -> int:
    """The first action of the cheapest motion, walls and blocks in the way considered."""
    rows = cost.reshape(ACTIONS_TRIED, -1)  # one for each first action
    rows[0] += _IDLE
    best = np.argpartition(rows, _TOP, axis=1)[:, :_TOP]
    top = (best + _ROW_STARTS * rows.shape[1]).ravel()
    total = cost[top] + _BLAME * _obstruction(table, top, sight, others)
    return int(table.first[top[total.argmin()]])


def _obstruction(
    table: Table, picks: NDArray[np.intp], sight: Sight, others: Sequence[Point]
) -> Floats:
    """By how many units each pick gets too close to walls and other blocks on its way."""
    turn = np.array(((sight.cos, sight.sin), (-sight.sin, sight.cos)))
    here = np.array((sight.x, sight.y))
    robot, block = table.robot[picks] @ turn + here, table.block[picks] @ turn + here  # (P, K, 2)
    # Room to back off once the block is let go, as if the way went on backwards.
    behind = (table.robot[picks, -1:] - REAR * table.ahead[picks, None]) @ turn + here
    robot = np.concatenate((robot, behind), axis=1)
    cost: Floats = np.maximum(0.0, np.abs(robot) - BODY_LIMIT).max(axis=(1, 2))
    cost += CORNERED * np.maximum(0.0, np.abs(behind) - BODY_LIMIT).max(axis=(1, 2))
    cost += 2.0 * np.maximum(0.0, np.abs(block) - BLOCK_LIMIT).sum(axis=2).mean(axis=1)
    if others:
        points = np.array(others)
        cost += _intrusion(robot, points, BODY_ROOM) + _intrusion(block, points, BLOCK_ROOM)
    return cost


def _intrusion(ways: Floats, points: Floats, room: float) -> Floats:
    """How much closer than `room` each way (P, K, 2) gets to the points (M, 2), in all."""
    offset = ways[:, :, None] - points
    distance = np.sqrt((offset * offset).sum(axis=-1))  # (P, K, M)
    least: Floats = np.maximum(0.0, room - distance.min(axis=1)).sum(axis=1)
    return least


def _wrap(angle: Floats) -> Floats:
    wrapped: Floats = (angle + math.pi) % (2 * math.pi) - math.pi
    return wrapped
