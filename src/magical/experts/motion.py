"""Driving and turning with the 18 actions.

A tap of one control step turns the robot by about 0.3 rad and there is no half tap, so headings
are corrected where the error is worth a tap, and judged at the angle where the turn will stop.
"""

import math

from magical.experts.sight import Sight, bearing, wrap
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.constants import CONTROL_RATE, TURN_MAX_BIAS
from magical.scene.geometry import Point

TAP = TURN_MAX_BIAS / CONTROL_RATE  # rad: one control step of turning
_BRAKING = 27.0  # rad / s^2: how fast an empty robot stops turning
_FAR = 0.5  # units: further away, heading errors can wait until they are worth a whole tap

STOP, FORWARD, BACK = Longitudinal


def action(drive: Longitudinal, turn: Turn, closed: bool) -> int:
    """The id of an action."""
    return Action(drive, turn, Gripper.CLOSED if closed else Gripper.OPEN).id


def heading_error(sight: Sight, heading: float) -> float:
    """What is left to turn, counter-clockwise, once the present turn has come to rest."""
    return wrap(heading - sight.angle - sight.spin * abs(sight.spin) / (2 * _BRAKING))


def turn_by(error: float, threshold: float = 0.55 * TAP) -> Turn:
    """The turn that reduces an error that is worth it."""
    if error > threshold:
        return Turn.LEFT
    return Turn.RIGHT if error < -threshold else Turn.STRAIGHT


def drive_to(sight: Sight, point: Point, closed: bool = False) -> int:
    """Head for a point, on an arc where there is room for one."""
    distance = sight.distance(point)
    error = heading_error(sight, bearing((sight.x, sight.y), point))
    turn = turn_by(error, 0.8 * TAP if distance > _FAR else 0.55 * TAP)
    # A full circle at full speed has a radius of 0.32: closer points need a turn on the spot.
    widest = 1.1 if distance > 0.6 else 0.6 if distance > 0.35 else 0.4
    return action(FORWARD if abs(error) < widest else STOP, turn, closed)


def back_off(sight: Sight, heading: float, closed: bool = False) -> int:
    """Drive backwards while turning to a heading."""
    return action(BACK, turn_by(heading_error(sight, heading), 0.8 * TAP), closed)


def back_straight(closed: bool = False) -> int:
    """Drive straight backwards."""
    return action(BACK, Turn.STRAIGHT, closed)


def reach_time(distance: float, angle: float) -> float:
    """About how many control steps a drive of `distance` with turns of `angle` rad takes."""
    return 2.0 + 10.0 * distance + abs(angle) / TAP


__all__ = [
    "BACK",
    "FORWARD",
    "STOP",
    "TAP",
    "action",
    "back_off",
    "back_straight",
    "drive_to",
    "heading_error",
    "math",
    "reach_time",
    "turn_by",
]
