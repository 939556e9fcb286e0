"""Driving without a block: to a place, and up to a block until it is between the open fingers.

A tap of one control step turns the robot by about 0.3 rad and there is no half tap, so headings
are corrected where the error is worth a tap, and judged at the angle where the turn will stop.
"""

import math
from collections.abc import Sequence

from magical.experts.grasp import CONE, CROWDED, GATE, JAW_HALF, TIGHT_CONE, behind, gate_to, in_jaw
from magical.experts.motions import HOLD, TAP
from magical.experts.paths import is_clear, next_waypoint
from magical.experts.sight import Sight, bearing, inside, wrap
from magical.scene import NOOP
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.geometry import Point

CLEARANCE = 0.34  # units from the robot's centre to an obstacle's when planning ways
TIGHT_CLEARANCE = 0.32  # units: the same when others may be pushed aside
SWEEP = 0.45  # units within which a turn on the spot would hit a block with the fingers
ARRIVED = 0.16  # units from the gate that are near enough
AIMED = 0.35  # rad: heading errors up to which it makes sense to drive on
ARC = 1.1  # rad: the same where there is room for an arc
_ARC_ROOM = 0.6  # units to the goal from which an arc is possible: its radius is 0.32 at full speed
_BRAKING = 27.0  # rad / s^2: how fast an empty robot stops turning
_FAR = 0.5  # units: further away, heading errors can wait until they are worth a whole tap
FRONT, FRONT_HALF = 0.5, 0.25  # units ahead and to the side where closing fingers touch a block
_REAR_LIMIT = 0.82  # largest coordinate of the point 0.1 behind the robot's centre


def travel(sight: Sight, goal: Point, obstacles: Sequence[Point], bold: bool = False) -> int:
    """Drive to a point around blocks that must not move, fingers open.

    The bold push blocks aside where the careful would back off.
    """
    here = (sight.x, sight.y)
    point = next_waypoint(
        here, goal, obstacles, TIGHT_CLEARANCE if bold else CLEARANCE, sight.angle
    )
    error = heading_error(sight, bearing(here, point))
    return _drive(sight, point, error) if bold else _head(sight, point, error, obstacles)


def approach(
    sight: Sight, block: Point, side: float, others: Sequence[Point], bold: bool = False
) -> int:
    """Drive so that the block comes between the open fingers at bearing `side`."""
    here = (sight.x, sight.y)
    straight, away = bearing(here, block), sight.distance(block)
    stand = behind(block, straight, HOLD)
    free = away < GATE + 0.12 or is_clear(here, stand, others, CLEARANCE - 0.04)
    crowded = any(math.dist(block, other) < CROWDED for other in others)
    gate = gate_to(block, side)
    askew = abs(wrap(straight - side)) > (TIGHT_CONE if crowded else CONE)
    if (askew or not free) and sight.distance(gate) > (2 * ARRIVED if bold else ARRIVED):
        return travel(sight, gate, (*others, block), bold)
    error = heading_error(sight, straight)
    held = _held(sight, others)
    if held is not None and (abs(error) > AIMED or sight.distance(held) < away - 0.1):
        return _leave(sight, held)
    x, y = sight.local(block)
    beside = abs(x) > JAW_HALF and 0.0 < y < 0.46  # a finger would push it
    if (abs(error) > AIMED or beside) and can_back(sight, others):
        if away < SWEEP:
            leave = Longitudinal.BACK if y > 0.0 else Longitudinal.FORWARD
            return _act(leave, turn_by(error, 0.8 * TAP))
        if not bold and _sweeps(sight, error, others, SWEEP):
            return _act(Longitudinal.BACK, Turn.STRAIGHT)
    return _drive(sight, block, error)


def remaining(sight: Sight, block: Point, side: float) -> float:
    """About how far the robot has to go until it can grasp a block at bearing `side`."""
    if abs(wrap(bearing((sight.x, sight.y), block) - side)) < CONE:
        return sight.distance(block)
    return sight.distance(gate_to(block, side)) + GATE


def heading_error(sight: Sight, heading: float) -> float:
    """What is left to turn, counter-clockwise, once the present turn has come to rest."""
    return wrap(heading - sight.angle - sight.spin * abs(sight.spin) / (2 * _BRAKING))


def turn_by(error: float, threshold: float) -> Turn:
    """The turn that reduces an error that is worth it."""
    if error > threshold:
        return Turn.LEFT
    return Turn.RIGHT if error < -threshold else Turn.STRAIGHT


def can_back(sight: Sight, obstacles: Sequence[Point]) -> bool:
    """Whether there is room behind the robot."""
    rear = sight.ahead(-0.1)
    return inside(rear, _REAR_LIMIT) and all(
        math.dist(rear, other) > 0.31 or sight.local(other)[1] > 0 for other in obstacles
    )


def _act(drive: Longitudinal, turn: Turn) -> int:
    return Action(drive, turn, Gripper.OPEN).id


def leave(sight: Sight, blocks: Sequence[Point]) -> int | None:
    """Back off, fingers open, until they can close without touching a block; then nothing."""
    close = next((block for block in blocks if _in_front(sight.local(block))), None)
    if close is None:
        return None
    return _leave(sight, close) if can_back(sight, blocks) else NOOP


def _in_front(local: Point) -> bool:
    return abs(local[0]) < FRONT_HALF and 0.0 < local[1] < FRONT


def _held(sight: Sight, others: Sequence[Point]) -> Point | None:
    """The block between the open fingers, if any, and if there is room to back off."""
    if not inside(sight.ahead(-0.1), _REAR_LIMIT):
        return None
    return next((other for other in others if in_jaw(sight, other)), None)


def _leave(sight: Sight, held: Point) -> int:
    """Back off a block, turning the finger that touches it outwards."""
    aside = sight.local(held)[0]
    return _act(Longitudinal.BACK, turn_by(-aside, 0.06))


def _head(sight: Sight, point: Point, error: float, obstacles: Sequence[Point]) -> int:
    """Drive towards a point, first backing off blocks that the fingers hold or would push."""
    held = _held(sight, obstacles)
    if held is not None:
        return _leave(sight, held)
    if (
        abs(error) > AIMED
        and _sweeps(sight, error, obstacles, SWEEP)
        and can_back(sight, obstacles)
    ):
        return _act(Longitudinal.BACK, Turn.STRAIGHT)
    return _drive(sight, point, error, arc=not _sweeps(sight, error, obstacles, 1.3 * SWEEP))


def _drive(sight: Sight, point: Point, error: float, arc: bool = True) -> int:
    """Head for a point; on an arc where that is allowed and there is room for one."""
    distance = sight.distance(point)
    turn = turn_by(error, (0.8 if distance > _FAR else 0.55) * TAP)
    widest = ARC if arc and distance > _ARC_ROOM else AIMED
    return _act(Longitudinal.FORWARD if abs(error) < widest else Longitudinal.STOP, turn)


def _sweeps(sight: Sight, error: float, obstacles: Sequence[Point], reach: float) -> bool:
    """Whether turning by `error` would push a block that is close in front."""
    low, high = min(0.0, error) - 0.5, max(0.0, error) + 0.5
    for obstacle in obstacles:
        x, y = sight.local(obstacle)
        if y > 0.1 and x * x + y * y < reach * reach and low < math.atan2(-x, y) < high:
            return True
    return False
