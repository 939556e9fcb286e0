"""Driving without a grasp: to a place, up to a block, away from blocks, and out when stuck.

One control step of turning turns the robot by about 0.3 rad, and there is no half step, so a
heading is corrected only if the error is worth a step, and judged at the angle at which the current
turn will stop.
"""

import math
from collections.abc import Sequence

from magical.experts.geometry import (
    CONTACT_DISTANCE,
    DRIVING_CLEARANCE,
    HELD_DISTANCE,
    TURN_STEP,
    WORKING_DISTANCE,
    bearing,
    is_within,
    wrap_angle,
)
from magical.experts.grasp import (
    CONE,
    GATE_DISTANCES,
    HALF_WIDTH,
    SWEEP_RADIUS,
    gate_point,
    is_between_fingers,
    point_behind,
)
from magical.experts.paths import is_clear, next_waypoint
from magical.experts.state_view import StateView
from magical.scene import NOOP
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.geometry import Point

# When a heading is corrected, and when the robot drives while it turns.
BRAKING = 27.0  # rad / s^2 at which an empty robot stops turning; measured: 26 to 28
FAR_DISTANCE = 0.5  # units: further away, heading errors may grow to a whole step; tuned
FAR_ERROR = 0.8 * TURN_STEP  # rad: larger errors are corrected, far away; tuned
NEAR_ERROR = 0.55 * TURN_STEP  # rad: larger errors are corrected, close by; tuned
AIMED = 0.35  # rad: heading error up to which the robot drives on; tuned
ARC = 1.1  # rad: the same if there is room for an arc; tuned
ARC_DISTANCE = 0.6  # units: such room, twice the arc's radius (measured: 0.32)

# How a block is brought between the open fingers.
ARRIVED = 0.16  # units from the gate at which the robot has reached it; tuned
DIRECT = GATE_DISTANCES[0] + 0.12  # units: nearer blocks are approached without a path; tuned
STRAIGHT_CLEARANCE = DRIVING_CLEARANCE - 0.04  # units to others on the straight approach; tuned
CROWDED_CONE = 0.25  # rad: replaces `CONE` if other blocks are near; tuned
FINGER_END = 0.46  # units ahead up to which a block beside a finger is hit; tuned

# Where turning and closing fingers touch blocks.
SWEEP_START = 0.1  # units ahead of the robot's centre where the sweep begins; tuned
SWEEP_MARGIN = 0.5  # rad on both sides of a turn that the fingers also sweep; tuned
ARC_SWEEP = 1.3  # times `SWEEP_RADIUS`: nearer blocks rule out an arc; tuned
CLOSING_LENGTH = 0.5  # units ahead up to which closing fingers touch a block; tuned
CLOSING_HALF_WIDTH = 0.25  # units to the side up to which they do; tuned

# Room behind the robot, and how it leaves a block.
REAR = 0.1  # units behind the robot's centre where free space is required; tuned
REAR_LIMIT = 0.82  # units: largest coordinate of that point; tuned
OFF_AXIS = 0.06  # units: the robot turns away from a block this far off its axis; tuned

_ESCAPES = (
    (Longitudinal.BACK, Turn.STRAIGHT),
    (Longitudinal.BACK, Turn.LEFT),
    (Longitudinal.BACK, Turn.RIGHT),
    (Longitudinal.FORWARD, Turn.LEFT),
    (Longitudinal.FORWARD, Turn.RIGHT),
)


def travel(
    view: StateView, goal: Point, obstacles: Sequence[Point], push_aside: bool = False
) -> int:
    """The action that drives to a point around blocks that must not be moved.

    With `push_aside` the robot pushes blocks aside instead of backing off.
    """
    clearance = CONTACT_DISTANCE if push_aside else DRIVING_CLEARANCE
    point = next_waypoint(view.position, goal, obstacles, clearance, view.angle)
    error = _heading_error(view, bearing(view.position, point))
    if push_aside:
        return _drive(view, point, error)
    held = _block_between_fingers(view, obstacles)
    if held is not None:
        return _leave(view, held)
    sweeps = _sweeps(view, error, obstacles, SWEEP_RADIUS)
    if abs(error) > AIMED and sweeps and _can_back(view, obstacles):
        return _open(Longitudinal.BACK, Turn.STRAIGHT)
    is_arc_free = not _sweeps(view, error, obstacles, ARC_SWEEP * SWEEP_RADIUS)
    return _drive(view, point, error, is_arc_free)


def approach(
    view: StateView, block: Point, side: float, others: Sequence[Point], push_aside: bool = False
) -> int:
    """The action that brings the block between the open fingers at bearing `side`."""
    gate = gate_point(block, side)
    arrived = 2 * ARRIVED if push_aside else ARRIVED
    if view.distance_to(gate) > arrived and not _is_direct(view, block, side, others):
        return travel(view, gate, (*others, block), push_aside)
    return _close_in(view, block, others, push_aside)


def _is_direct(view: StateView, block: Point, side: float, others: Sequence[Point]) -> bool:
    """Whether the robot can drive straight at the block without passing its gate."""
    straight = bearing(view.position, block)
    crowded = any(math.dist(block, other) < WORKING_DISTANCE for other in others)
    if abs(wrap_angle(straight - side)) > (CROWDED_CONE if crowded else CONE):
        return False
    if view.distance_to(block) < DIRECT:
        return True
    stand = point_behind(block, straight, HELD_DISTANCE)
    return is_clear(view.position, stand, others, STRAIGHT_CLEARANCE)


def _close_in(view: StateView, block: Point, others: Sequence[Point], push_aside: bool) -> int:
    """Drive straight at the block; back off first if a turn would push something."""
    away = view.distance_to(block)
    error = _heading_error(view, bearing(view.position, block))
    is_misaimed = abs(error) > AIMED
    held = _block_between_fingers(view, others)
    if held is not None and (is_misaimed or view.distance_to(held) < away - 0.1):
        return _leave(view, held)
    x, y = view.to_robot_frame(block)
    is_beside_finger = abs(x) > HALF_WIDTH and 0.0 < y < FINGER_END
    if (is_misaimed or is_beside_finger) and _can_back(view, others):
        if away < SWEEP_RADIUS:
            retreat = Longitudinal.BACK if y > 0.0 else Longitudinal.FORWARD
            return _open(retreat, _turn_towards(error, FAR_ERROR))
        if not push_aside and _sweeps(view, error, others, SWEEP_RADIUS):
            return _open(Longitudinal.BACK, Turn.STRAIGHT)
    return _drive(view, block, error)


def remaining_distance(view: StateView, block: Point, side: float) -> float:
    """Approximate distance that the robot must drive to grasp a block at bearing `side`."""
    if abs(wrap_angle(bearing(view.position, block) - side)) < CONE:
        return view.distance_to(block)
    return view.distance_to(gate_point(block, side)) + GATE_DISTANCES[0]


def back_off(view: StateView, blocks: Sequence[Point]) -> int | None:
    """Drive back, fingers open, until they can close without touching a block; then None."""
    for block in blocks:
        x, y = view.to_robot_frame(block)
        if abs(x) < CLOSING_HALF_WIDTH and 0.0 < y < CLOSING_LENGTH:
            return _leave(view, block) if _can_back(view, blocks) else NOOP
    return None


def escape(attempt: int, with_block: bool) -> int:
    """The action that drives a stuck robot away: backwards, then in other ways.

    Args:
        attempt: how often the robot has been stuck, from 1; each time tries another way.
        with_block: whether to pull the held block along instead of releasing it.
    """
    if with_block:
        return Action(Longitudinal.BACK, Turn.STRAIGHT, Gripper.CLOSED).id
    return _open(*_ESCAPES[(attempt - 1) % len(_ESCAPES)])


def _heading_error(view: StateView, heading: float) -> float:
    """Radians left to turn, counter-clockwise, once the current turn has come to rest."""
    stopping = view.spin * abs(view.spin) / (2 * BRAKING)
    return wrap_angle(heading - view.angle - stopping)


def _turn_towards(error: float, threshold: float) -> Turn:
    """The turn that reduces a heading error larger than a threshold."""
    if error > threshold:
        return Turn.LEFT
    return Turn.RIGHT if error < -threshold else Turn.STRAIGHT


def _can_back(view: StateView, obstacles: Sequence[Point]) -> bool:
    """Whether there is room behind the robot."""
    rear = view.point_ahead(-REAR)
    return _has_wall_free_rear(view) and all(
        math.dist(rear, other) > CONTACT_DISTANCE or view.to_robot_frame(other)[1] > 0
        for other in obstacles
    )


def _has_wall_free_rear(view: StateView) -> bool:
    return is_within(view.point_ahead(-REAR), REAR_LIMIT)


def _open(drive: Longitudinal, turn: Turn) -> int:
    return Action(drive, turn, Gripper.OPEN).id


def _drive(view: StateView, point: Point, error: float, is_arc_free: bool = True) -> int:
    """Head for a point, on an arc if one is free and there is room for it."""
    distance = view.distance_to(point)
    turn = _turn_towards(error, FAR_ERROR if distance > FAR_DISTANCE else NEAR_ERROR)
    widest = ARC if is_arc_free and distance > ARC_DISTANCE else AIMED
    return _open(Longitudinal.FORWARD if abs(error) < widest else Longitudinal.STOP, turn)


def _leave(view: StateView, block: Point) -> int:
    """Back off a block, turning the finger that touches it outwards."""
    aside = view.to_robot_frame(block)[0]
    return _open(Longitudinal.BACK, _turn_towards(-aside, OFF_AXIS))


def _block_between_fingers(view: StateView, others: Sequence[Point]) -> Point | None:
    """The block between the open fingers; None if there is none, or no room to back off."""
    if not _has_wall_free_rear(view):
        return None
    return next((other for other in others if is_between_fingers(view, other)), None)


def _sweeps(view: StateView, error: float, obstacles: Sequence[Point], radius: float) -> bool:
    """Whether turning by `error` would push a block in front that is nearer than `radius`."""
    low, high = min(0.0, error) - SWEEP_MARGIN, max(0.0, error) + SWEEP_MARGIN
    for obstacle in obstacles:
        x, y = view.to_robot_frame(obstacle)
        if y > SWEEP_START and math.hypot(x, y) < radius and low < math.atan2(-x, y) < high:
            return True
    return False
