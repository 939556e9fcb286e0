"""Getting a block between the fingers: from which side, and how to get there.

The grip is tolerant: a block up to 0.09 units off the robot's axis is caught and carried, and
closing takes no time of its own while the robot drives on.
"""

import math
from collections.abc import Sequence

from magical.experts.motions import HOLD, TAP, reach_time
from magical.experts.paths import gap
from magical.experts.sight import Sight, bearing, inside, wrap
from magical.scene.constants import BLOCK_SIZE
from magical.scene.geometry import Point

REACH = 0.42  # units ahead of the robot up to which the fingers catch a block
JAW_HALF = 0.12  # units to the side up to which they do
NEAREST_GATE = 0.42  # units: the same where a wall is behind the robot
SLACK = 0.03  # units that a held block may slip further before it counts as lost
GATE = 0.56  # units from a block's centre where the last straight approach starts
SWEEP = 0.53  # units within which a turn on the spot would hit a block with the fingers
HABIT = 6.0  # control steps that a new side must be better by
CLEARANCE = 0.34  # units from the robot's centre to an obstacle's while driving
REACHABLE = 0.79  # largest coordinate of the robot's centre
CONE = 0.5  # rad around the chosen side within which a block is approached directly
TIGHT_CONE = 0.25  # the same where other blocks are close
CROWDED = 0.45  # units: how close that is
SIDES = 16


def in_jaw(sight: Sight, block: Point, held: int = 0) -> bool:
    """Whether the fingers hold the block or would on closing; `held` for how many steps now."""
    x, y = sight.local(block)
    slack = SLACK if held else 0.0
    return abs(x) < JAW_HALF + slack and 0.0 < y < REACH + slack


def behind(block: Point, side: float, distance: float) -> Point:
    """The point from which the block is `distance` away at bearing `side`."""
    return block[0] + math.sin(side) * distance, block[1] - math.cos(side) * distance


def gate_to(block: Point, side: float) -> Point:
    """Where the last straight approach to a block starts: nearer where a wall leaves no room."""
    distance = GATE
    while distance > NEAREST_GATE and not inside(behind(block, side, distance), REACHABLE):
        distance -= 0.04
    return behind(block, side, distance)


def best_side(
    sight: Sight,
    block: Point,
    goal: Point,
    others: Sequence[Point],
    taste: Sequence[float],
    used: float | None = None,
) -> tuple[float, float]:
    """The bearing to grasp a block from, and the control steps until it is at `goal`, about.

    `taste` is an extra cost of each of the `SIDES` bearings, in control steps; `used` is the
    bearing that was chosen before and is only left for a clearly better one.
    """
    near = [other for other in others if math.dist(other, block) < GATE + CLEARANCE]
    direct = bearing((sight.x, sight.y), block)
    best = (direct, _cost(sight, block, goal, near, others, direct) + taste[0])
    for i in range(SIDES):
        side = wrap(2 * math.pi * i / SIDES)
        cost = _cost(sight, block, goal, near, others, side) + taste[i]
        if cost < best[1]:
            best = (side, cost)
    if used is not None:
        cost = _cost(sight, block, goal, near, others, used)
        return best if best[1] < cost - HABIT else (used, cost)
    return best


def _cost(
    sight: Sight,
    block: Point,
    goal: Point,
    near: list[Point],
    others: Sequence[Point],
    side: float,
) -> float:
    stand, gate = behind(block, side, HOLD), gate_to(block, side)
    return (
        _travel(sight, block, gate, side)
        + sum(15.0 * max(0.0, CLEARANCE - gap((sight.x, sight.y), gate, o)) for o in others)
        + _crowding(block, stand, gate, near, side)
        + carry_time(stand, block, side, goal)
    )


def _travel(sight: Sight, block: Point, gate: Point, side: float) -> float:
    """Control steps until the robot stands there with the block between its fingers."""
    here = (sight.x, sight.y)
    away = math.dist(here, block)
    straight = bearing(here, block)
    if abs(wrap(straight - side)) < CONE:
        retreat = max(0.0, SWEEP - away) if abs(wrap(straight - sight.angle)) > 0.4 else 0.0
        return reach_time(away - HOLD + 2 * retreat, wrap(straight - sight.angle))
    way = bearing(here, gate)
    detour = 0.5 * max(0.0, CLEARANCE - gap(here, gate, block)) / CLEARANCE
    distance = math.dist(here, gate) + detour + GATE - HOLD
    return reach_time(distance, abs(wrap(way - sight.angle)) + abs(wrap(side - way)))


def _crowding(block: Point, stand: Point, gate: Point, near: list[Point], side: float) -> float:
    """What it costs that walls and other blocks are in the way of robot and fingers."""
    cost = 300.0 * max(0.0, abs(stand[0]) - REACHABLE, abs(stand[1]) - REACHABLE)
    cost += 40.0 * max(0.0, abs(gate[0]) - REACHABLE, abs(gate[1]) - REACHABLE)
    dx, dy = 0.18 * math.cos(side), 0.18 * math.sin(side)
    tips = ((block[0] + dx, block[1] + dy), (block[0] - dx, block[1] - dy))
    for tip in tips:
        cost += 0.0 if inside(tip, 0.98) else 8.0
    for other in near:
        cost += 150.0 * max(0.0, CLEARANCE - 0.02 - gap(stand, gate, other))
        for tip in tips:
            cost += 150.0 * max(0.0, BLOCK_SIZE + 0.03 - math.dist(tip, other))
    return cost


def carry_time(stand: Point, block: Point, side: float, goal: Point) -> float:
    """Control steps to bring a held block to a goal, forwards or backwards."""
    distance = math.dist(block, goal)
    turn = abs(wrap(bearing(stand, goal) - side))
    forwards = 10.0 * distance + 1.3 * turn / TAP
    turn = abs(wrap(bearing(goal, block) - side))
    backwards = 14.0 * distance + 1.3 * turn / TAP + 2.0
    return min(forwards, backwards)
