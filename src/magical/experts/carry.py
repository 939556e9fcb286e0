"""Bringing a held block to its place: forwards, backwards or turning, whichever is shorter."""

import math
from collections.abc import Sequence

from magical.experts import motion
from magical.experts.grasp import HOLD, can_back
from magical.experts.paths import next_waypoint
from magical.experts.sight import Sight, bearing, inside, wrap
from magical.scene.geometry import Point

CLEARANCE = 0.31  # units from a carried block's centre to an obstacle's
_NEAR = 0.75  # units: closer goals are faced before driving on
_REVERSE_CONE = 0.8  # rad
_REVERSE_LENGTH = 0.8  # units


def carry(sight: Sight, block: Point, goal: Point, others: Sequence[Point]) -> int:
    """Move on with the block between closed fingers."""
    if _behind_us(sight, block, goal) and can_back(sight, others):
        return motion.back_off(sight, bearing(goal, block), closed=True)
    way = [other for other in others if math.dist(other, goal) > CLEARANCE]
    point = next_waypoint(block, goal, way, CLEARANCE)
    here = (sight.x, sight.y)
    heading = bearing(here, point)
    error = motion.heading_error(sight, heading)
    turn = motion.turn_by(error, 0.5 * motion.TAP)
    distance = sight.distance(point)
    if abs(error) < (1.0 if distance > _NEAR else 0.35):
        drive = motion.FORWARD if distance * math.cos(error) > HOLD else motion.BACK
        return motion.action(drive, turn, True)
    if distance < HOLD - 0.05 or not _swing_is_free(sight, error, others):
        if can_back(sight, others):
            return motion.action(motion.BACK, turn, True)
    return motion.action(motion.STOP, turn, True)


def _behind_us(sight: Sight, block: Point, goal: Point) -> bool:
    """Whether pulling the block backwards is the short way."""
    if math.dist(block, goal) > _REVERSE_LENGTH:
        return False
    return abs(wrap(bearing(goal, block) - sight.angle)) < _REVERSE_CONE


def _swing_is_free(sight: Sight, error: float, others: Sequence[Point]) -> bool:
    """Whether the held block can turn towards the goal without hitting a wall or a block."""
    for part in (0.5, 1.0):
        point = sight.ahead(HOLD, part * math.copysign(min(abs(error), 1.2), error))
        if not inside(point, 0.86) or any(math.dist(point, other) < 0.26 for other in others):
            return False
    return True
