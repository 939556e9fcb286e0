"""The skills: travel to a place, get a block between the fingers, carry it.

Each scores all short motions by the control steps, about, until it would be done after them, adds
what walls and blocks in the way cost for the best, and takes the cheapest one's first action.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magical.experts.grasp import CONE, CROWDED, GATE, TIGHT_CONE, behind
from magical.experts.motions import ACTIONS_TRIED, EMPTY, HOLD, LOADED, STEP, TAP, Floats, Table, table_for
from magical.experts.paths import is_clear, next_waypoint
from magical.experts.sight import Sight, bearing, inside, wrap
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.geometry import Point

BODY_ROOM = 0.31  # units from the robot's centre to a block's
TIP_ROOM = 0.15  # units from a finger to a block's centre
BLOCK_ROOM = 0.26  # units between two blocks' centres
CARRY_CLEARANCE = 0.31  # units from a carried block's centre to an obstacle's when planning ways
CLEARANCE = 0.34  # units from the robot's centre to an obstacle's when planning ways
CATCH = HOLD + 0.03  # units from the robot's centre to a block's that the fingers can close on
_BLAME = 50.0  # control steps, per unit, that getting too close costs
_FINAL_BLAME = 12.0  # the same close to a block to be grasped: its neighbours may be pushed aside
_LOADED_BLAME = 45.0  # the same with a block in hand: two blocks are hard to push
_MORE = 4.0  # control steps that any further correction takes
_TOP = 5  # motions, for each first action, that are checked for obstacles
_ROW_STARTS = np.arange(ACTIONS_TRIED)[:, None]
_IDLE = 4.0  # control steps that standing still seems to cost
_LEAVE = Action(Longitudinal.BACK, Turn.STRAIGHT, Gripper.OPEN).id
_CLOSED = 9  # added to an action's id: the same with closed fingers
_NEAR = 0.9  # units from a block within which the robot lines up with it


def travel(sight: Sight, goal: Point, obstacles: Sequence[Point]) -> int:
    """Drive to a point around blocks that must not move, fingers open."""
    if _must_leave(sight, obstacles):
        return _LEAVE
    point = next_waypoint((sight.x, sight.y), goal, obstacles, CLEARANCE)
    table = table_for(EMPTY, sight.speed, sight.spin)
    offset = np.array(sight.local(point)) - table.robot[:, -1]  # (N, 2)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    turn = np.abs(_wrap(np.arctan2(-offset[:, 0], offset[:, 1]) - table.turned))
    to_go = distance / STEP + np.minimum(turn / TAP, 20.0 * distance)
    return _pick(sight, table, table.time + to_go, obstacles, _BLAME)


def approach(sight: Sight, block: Point, side: float, others: Sequence[Point]) -> int:
    """Drive so that the block comes between the open fingers at bearing `side`."""
    away = sight.distance(block)
    if _must_leave(sight, [other for other in others if sight.distance(other) < away - 0.1]):
        return _LEAVE
    here = (sight.x, sight.y)
    straight = bearing(here, block)
    crowded = any(math.dist(block, other) < CROWDED for other in others)
    cone = TIGHT_CONE if crowded else CONE
    close = away < _NEAR and abs(wrap(straight - side)) < 1.0
    direct = abs(wrap(straight - side)) < cone
    stand = behind(block, straight, HOLD)
    if not (direct or close) or not is_clear(here, stand, others, CLEARANCE - 0.04):
        gate = behind(block, side, GATE)
        if sight.distance(gate) > 0.15:
            return travel(sight, gate, (*others, block))
    table = table_for(EMPTY, sight.speed, sight.spin)
    cost = table.time + _to_grasp(table, sight.local(block), side - sight.angle, cone)
    return _pick(sight, table, cost, others, _BLAME if away > GATE else _FINAL_BLAME)


def carry(
    sight: Sight, block: Point, goal: Point, tolerance: float, others: Sequence[Point]
) -> int:
    """Move on with the block between closed fingers."""
    way = [other for other in others if math.dist(other, goal) > CARRY_CLEARANCE]
    point = next_waypoint(block, goal, way, CARRY_CLEARANCE)
    table = table_for(LOADED, sight.speed, sight.spin)
    near = tolerance if point == goal else 0.1
    cost = table.time + _to_place(table, sight.local(block), sight.local(point), near)
    return _CLOSED + _pick(sight, table, cost, others, _LOADED_BLAME, loaded=True)


def _must_leave(sight: Sight, others: Sequence[Point]) -> bool:
    """Whether a block that is not to be moved is between the open fingers."""
    if not inside(sight.ahead(-0.1), 0.82):
        return False
    return any(abs(x) < 0.13 and 0.0 < y < 0.44 for x, y in map(sight.local, others))


def _to_grasp(table: Table, block: Point, side: float, cone: float) -> Floats:
    """Control steps, about, from the end of each motion until the fingers can close."""
    offset = np.array(block) - table.robot[:, -1]  # (N, 2)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    towards = np.arctan2(-offset[:, 0], offset[:, 1])
    aim = np.abs(_wrap(towards - table.turned))
    askew = np.maximum(0.0, np.abs(_wrap(towards - side)) - cone)
    missing = np.maximum(0.0, distance - CATCH)
    aside = np.maximum(0.0, np.sin(np.minimum(aim, 1.57)) * distance - 0.05)
    local = np.array((block,))
    pushed = _intrusion(table.robot, local, HOLD - 0.025) + _intrusion(table.tips, local, 0.11)
    to_go: Floats = missing / STEP + aim / TAP + 20.0 * askew + 40.0 * (aside + pushed)
    return to_go


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


def _pick(
    sight: Sight,
    table: Table,
    cost: Floats,
    others: Sequence[Point],
    blame: float,
    *,
    loaded: bool = False,
) -> int:
    """The first action of the cheapest motion, walls and blocks in the way considered."""
    rows = cost.reshape(ACTIONS_TRIED, -1)  # one for each first action
    rows[0] += _IDLE
    best = np.argpartition(rows, _TOP, axis=1)[:, :_TOP]
    top = (best + _ROW_STARTS * rows.shape[1]).ravel()
    total = cost[top] + blame * _obstruction(table, top, sight, others, loaded)
    return int(table.first[top[total.argmin()]])


def _obstruction(
    table: Table, picks: NDArray[np.intp], sight: Sight, others: Sequence[Point], loaded: bool
) -> Floats:
    """By how many units each pick gets too close to walls and other blocks on its way."""
    turn = np.array(((sight.cos, sight.sin), (-sight.sin, sight.cos)))
    here = np.array((sight.x, sight.y))
    robot = table.robot[picks] @ turn + here  # (P, K, 2)
    front = (table.block if loaded else table.front)[picks] @ turn + here
    cost: Floats = np.maximum(0.0, np.abs(robot) - 0.8).max(axis=(1, 2))
    cost += 2.0 * np.maximum(0.0, np.abs(front) - 0.84).sum(axis=2).mean(axis=1)
    if others:
        points = np.array(others)
        cost += _intrusion(robot, points, BODY_ROOM)
        cost += _intrusion(front, points, BLOCK_ROOM if loaded else TIP_ROOM)
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
