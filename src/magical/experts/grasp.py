"""Getting a block between the fingers: from which side, and how to get there.

The grip is tolerant: a block up to 0.09 units off the robot's axis is caught and carried, and
closing takes no time of its own while the robot drives on.
"""

import math
from collections.abc import Sequence

from magical.experts import motion
from magical.experts.paths import gap, is_clear, next_waypoint
from magical.experts.sight import Sight, bearing, inside, wrap
from magical.scene.constants import BLOCK_SIZE, ROBOT_RADIUS
from magical.scene.geometry import Point

HOLD = ROBOT_RADIUS + BLOCK_SIZE + 0.015  # units from the robot's centre to a held block's
REACH = 0.42  # units ahead of the robot up to which the fingers catch a block
JAW_HALF = 0.12  # units to the side up to which they do
GATE = 0.56  # units from a block's centre where the last straight approach starts
SWEEP = 0.53  # units within which a turn on the spot would hit a block with the fingers
CLEARANCE = 0.34  # units from the robot's centre to an obstacle's while driving
REACHABLE = 0.79  # largest coordinate of the robot's centre
CONE = 0.5  # rad around the chosen side within which a block is approached directly
SIDES = 16


def in_jaw(sight: Sight, block: Point) -> bool:
    """Whether the fingers hold the block or would on closing."""
    x, y = sight.local(block)
    return abs(x) < JAW_HALF and 0.0 < y < REACH


def behind(block: Point, side: float, distance: float) -> Point:
    """The point from which the block is `distance` away at bearing `side`."""
    return block[0] + math.sin(side) * distance, block[1] - math.cos(side) * distance


def best_side(
    sight: Sight, block: Point, goal: Point, others: Sequence[Point], taste: Sequence[float]
) -> tuple[float, float]:
    """The bearing to grasp a block from, and the control steps until it is at `goal`, about.

    `taste` is an extra cost of each of the `SIDES` bearings, in control steps.
    """
    near = [other for other in others if math.dist(other, block) < GATE + CLEARANCE]
    direct = bearing((sight.x, sight.y), block)
    best = (direct, _cost(sight, block, goal, near, others, direct) + taste[0])
    for i in range(SIDES):
        side = wrap(2 * math.pi * i / SIDES)
        cost = _cost(sight, block, goal, near, others, side) + taste[i]
        if cost < best[1]:
            best = (side, cost)
    return best


def _cost(
    sight: Sight,
    block: Point,
    goal: Point,
    near: list[Point],
    others: Sequence[Point],
    side: float,
) -> float:
    stand, gate = behind(block, side, HOLD), behind(block, side, GATE)
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
        return motion.reach_time(away - HOLD + 2 * retreat, wrap(straight - sight.angle))
    way = bearing(here, gate)
    detour = 0.5 * max(0.0, CLEARANCE - gap(here, gate, block)) / CLEARANCE
    distance = math.dist(here, gate) + detour + GATE - HOLD
    return motion.reach_time(distance, abs(wrap(way - sight.angle)) + abs(wrap(side - way)))


def _crowding(
    block: Point, stand: Point, gate: Point, near: list[Point], side: float
) -> float:
    """What it costs that walls and other blocks are in the way of robot and fingers."""
    cost = 300.0 * max(0.0, abs(stand[0]) - REACHABLE, abs(stand[1]) - REACHABLE)
    cost += 40.0 * max(0.0, abs(gate[0]) - REACHABLE, abs(gate[1]) - REACHABLE)
    dx, dy = 0.18 * math.cos(side), 0.18 * math.sin(side)
    tips = ((block[0] + dx, block[1] + dy), (block[0] - dx, block[1] - dy))
    for tip in tips:
        cost += 0.0 if inside(tip, 0.98) else 8.0
    for other in near:
        cost += 60.0 * max(0.0, CLEARANCE - 0.02 - gap(stand, gate, other))
        for tip in tips:
            cost += 50.0 * max(0.0, BLOCK_SIZE + 0.03 - math.dist(tip, other))
    return cost


def carry_time(stand: Point, block: Point, side: float, goal: Point) -> float:
    """Control steps to bring a held block to a goal, forwards or backwards."""
    distance = math.dist(block, goal)
    turn = abs(wrap(bearing(stand, goal) - side))
    forwards = 10.0 * distance + 1.3 * turn / motion.TAP
    turn = abs(wrap(bearing(goal, block) - side))
    backwards = 14.0 * distance + 1.3 * turn / motion.TAP + 2.0
    return min(forwards, backwards)


def approach(sight: Sight, block: Point, side: float, others: Sequence[Point]) -> int:
    """Drive so that the block comes between the open fingers at bearing `side`."""
    here = (sight.x, sight.y)
    straight = bearing(here, block)
    away = sight.distance(block)
    stand = behind(block, straight, HOLD)
    free = away < GATE + 0.12 or is_clear(here, stand, others, CLEARANCE - 0.04)
    if abs(wrap(straight - side)) > CONE or not free:
        return travel(sight, behind(block, side, GATE), (*others, block))
    error = motion.heading_error(sight, straight)
    if abs(error) > 0.35 and can_back(sight, others):
        if away < SWEEP:
            return motion.back_off(sight, straight)
        if sweeps(sight, error, others):
            return motion.back_straight()
    return motion.drive_to(sight, block)


def travel(sight: Sight, goal: Point, obstacles: Sequence[Point]) -> int:
    """Drive to a point around blocks that must not move, first backing off those in the way."""
    here = (sight.x, sight.y)
    point = next_waypoint(here, goal, obstacles, CLEARANCE)
    error = motion.heading_error(sight, bearing(here, point))
    if sweeps(sight, error, obstacles) and can_back(sight, obstacles):
        return motion.back_straight()
    return motion.drive_to(sight, point)


def sweeps(sight: Sight, error: float, obstacles: Sequence[Point]) -> bool:
    """Whether turning by `error`, or driving on, would push a block that is close in front."""
    low, high = min(0.0, error) - 0.5, max(0.0, error) + 0.5
    for obstacle in obstacles:
        x, y = sight.local(obstacle)
        if 0.1 < y < 0.45 and abs(x) < JAW_HALF:
            return True
        if abs(error) < 0.35 or y < 0.1 or x * x + y * y > SWEEP * SWEEP:
            continue
        if low < math.atan2(-x, y) < high:
            return True
    return False


def can_back(sight: Sight, obstacles: Sequence[Point]) -> bool:
    """Whether there is room behind the robot."""
    rear = sight.ahead(-0.1)
    return inside(rear, REACHABLE + 0.03) and all(
        math.dist(rear, other) > 0.31 or sight.local(other)[1] > 0 for other in obstacles
    )
