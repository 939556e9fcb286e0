"""Driving without a grasp: to a place, up to a block, back off blocks, and out of being stuck.

One control step of turning turns the robot by about 0.3 rad and there is no half step, so a heading
is corrected only where the error is worth a step, and judged at the angle where the present turn
will stop.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from magical.experts.distances import (
    CONTACT_DISTANCE,
    DRIVING_CLEARANCE,
    HELD_DISTANCE,
    WORKING_DISTANCE,
)
from magical.experts.grasp import GRASP, gate_point, is_between_fingers, point_behind
from magical.experts.motions import TURN_STEP
from magical.experts.paths import is_clear, next_waypoint
from magical.experts.state_view import StateView, bearing, is_within, wrap_angle
from magical.scene import NOOP
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.geometry import Point


@dataclass(frozen=True, slots=True)
class HeadingSettings:
    """When a heading is corrected, and when the robot drives while it turns."""

    braking: float = 27.0  # rad / s^2 at which an empty robot stops turning; measured: 26 to 28
    far: float = 0.5  # units: further away, heading errors may grow to a whole step; tuned
    far_error: float = 0.8 * TURN_STEP  # rad: corrected above, far away; tuned
    near_error: float = 0.55 * TURN_STEP  # rad: corrected above, close; tuned
    aimed: float = 0.35  # rad: heading error up to which the robot drives on; tuned
    arc: float = 1.1  # rad: the same where there is room for an arc; tuned
    arc_distance: float = 0.6  # units: such room; twice the arc's radius, measured: 0.32


@dataclass(frozen=True, slots=True)
class ApproachSettings:
    """How a block is brought between the open fingers."""

    arrived: float = 0.16  # units from the gate that are near enough; tuned
    direct: float = GRASP.gate + 0.12  # units: nearer blocks are approached without a path; tuned
    clearance: float = DRIVING_CLEARANCE - 0.04  # units to others on the straight approach; tuned
    crowded_cone: float = 0.25  # rad off its side within which it then starts; tuned
    finger_end: float = 0.46  # units ahead up to which a block beside a finger is hit; tuned


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Where turning and closing fingers touch blocks."""

    start: float = 0.1  # units ahead of the robot's centre where it begins; tuned
    margin: float = 0.5  # rad on both sides of a turn that the fingers sweep too; tuned
    arc_radius: float = 1.3  # of `GRASP.sweep`: nearer blocks forbid an arc; tuned
    closing_length: float = 0.5  # units ahead up to which closing fingers touch a block; tuned
    closing_half_width: float = 0.25  # units to the side up to which they do; tuned


@dataclass(frozen=True, slots=True)
class BackingSettings:
    """Room behind the robot, and how it leaves a block."""

    rear: float = 0.1  # units behind the robot's centre where free space is sought; tuned
    limit: float = 0.82  # units: largest coordinate of that point; tuned
    block_distance: float = CONTACT_DISTANCE  # units from that point to blocks; geometry
    off_axis: float = 0.06  # units: a block this far off the axis is turned away from; tuned


HEADING = HeadingSettings()
APPROACH = ApproachSettings()
SWEEP = SweepSettings()
BACKING = BackingSettings()

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

    With `push_aside` the robot pushes blocks aside where it would otherwise back off.
    """
    clearance = CONTACT_DISTANCE if push_aside else DRIVING_CLEARANCE
    point = next_waypoint(view.position, goal, obstacles, clearance, view.angle)
    error = heading_error(view, bearing(view.position, point))
    if push_aside:
        return _drive(view, point, error)
    held = _block_between_fingers(view, obstacles)
    if held is not None:
        return _leave(view, held)
    sweeps = _sweeps(view, error, obstacles, GRASP.sweep)
    if abs(error) > HEADING.aimed and sweeps and can_back(view, obstacles):
        return _open(Longitudinal.BACK, Turn.STRAIGHT)
    is_arc_free = not _sweeps(view, error, obstacles, SWEEP.arc_radius * GRASP.sweep)
    return _drive(view, point, error, is_arc_free)


def approach(
    view: StateView, block: Point, side: float, others: Sequence[Point], push_aside: bool = False
) -> int:
    """The action that brings the block between the open fingers at bearing `side`."""
    gate = gate_point(block, side)
    arrived = 2 * APPROACH.arrived if push_aside else APPROACH.arrived
    if view.distance_to(gate) > arrived and not _is_direct(view, block, side, others):
        return travel(view, gate, (*others, block), push_aside)
    return _close_in(view, block, others, push_aside)


def _is_direct(view: StateView, block: Point, side: float, others: Sequence[Point]) -> bool:
    """Whether the robot can drive straight at the block without passing its gate."""
    straight = bearing(view.position, block)
    crowded = any(math.dist(block, other) < WORKING_DISTANCE for other in others)
    if abs(wrap_angle(straight - side)) > (APPROACH.crowded_cone if crowded else GRASP.cone):
        return False
    if view.distance_to(block) < APPROACH.direct:
        return True
    stand = point_behind(block, straight, HELD_DISTANCE)
    return is_clear(view.position, stand, others, APPROACH.clearance)


def _close_in(view: StateView, block: Point, others: Sequence[Point], push_aside: bool) -> int:
    """Drive straight at the block; back off first where a turn would push something."""
    away = view.distance_to(block)
    error = heading_error(view, bearing(view.position, block))
    is_misaimed = abs(error) > HEADING.aimed
    held = _block_between_fingers(view, others)
    if held is not None and (is_misaimed or view.distance_to(held) < away - 0.1):
        return _leave(view, held)
    x, y = view.to_robot_frame(block)
    is_beside_finger = abs(x) > GRASP.half_width and 0.0 < y < APPROACH.finger_end
    if (is_misaimed or is_beside_finger) and can_back(view, others):
        if away < GRASP.sweep:
            retreat = Longitudinal.BACK if y > 0.0 else Longitudinal.FORWARD
            return _open(retreat, turn_towards(error, HEADING.far_error))
        if not push_aside and _sweeps(view, error, others, GRASP.sweep):
            return _open(Longitudinal.BACK, Turn.STRAIGHT)
    return _drive(view, block, error)


def remaining_distance(view: StateView, block: Point, side: float) -> float:
    """About how far the robot has to drive until it can grasp a block at bearing `side`."""
    if abs(wrap_angle(bearing(view.position, block) - side)) < GRASP.cone:
        return view.distance_to(block)
    return view.distance_to(gate_point(block, side)) + GRASP.gate


def back_off(view: StateView, blocks: Sequence[Point]) -> int | None:
    """Drive back, fingers open, until they can close without touching a block; then None."""
    touched = (block for block in blocks if _is_in_closing_range(view.to_robot_frame(block)))
    block = next(touched, None)
    if block is None:
        return None
    return _leave(view, block) if can_back(view, blocks) else NOOP


def escape(attempt: int, with_block: bool) -> int:
    """The action that drives away where the robot is stuck: backwards, then in other ways.

    Args:
        attempt: Times that the robot has been stuck, from 1; each tries another way.
        with_block: Whether to pull the held block along instead of releasing it.
    """
    if with_block:
        return Action(Longitudinal.BACK, Turn.STRAIGHT, Gripper.CLOSED).id
    return _open(*_ESCAPES[(attempt - 1) % len(_ESCAPES)])


def heading_error(view: StateView, heading: float) -> float:
    """Radians left to turn, counter-clockwise, once the present turn has come to rest."""
    stopping = view.spin * abs(view.spin) / (2 * HEADING.braking)
    return wrap_angle(heading - view.angle - stopping)


def turn_towards(error: float, threshold: float) -> Turn:
    """The turn that reduces a heading error larger than a threshold."""
    if error > threshold:
        return Turn.LEFT
    return Turn.RIGHT if error < -threshold else Turn.STRAIGHT


def can_back(view: StateView, obstacles: Sequence[Point]) -> bool:
    """Whether there is room behind the robot."""
    rear = view.point_ahead(-BACKING.rear)
    return _has_wall_free_rear(view) and all(
        math.dist(rear, other) > BACKING.block_distance or view.to_robot_frame(other)[1] > 0
        for other in obstacles
    )


def _has_wall_free_rear(view: StateView) -> bool:
    return is_within(view.point_ahead(-BACKING.rear), BACKING.limit)


def _open(drive: Longitudinal, turn: Turn) -> int:
    return Action(drive, turn, Gripper.OPEN).id


def _drive(view: StateView, point: Point, error: float, is_arc_free: bool = True) -> int:
    """Head for a point; on an arc where one is free and there is room for it."""
    distance = view.distance_to(point)
    turn = turn_towards(error, HEADING.far_error if distance > HEADING.far else HEADING.near_error)
    widest = HEADING.arc if is_arc_free and distance > HEADING.arc_distance else HEADING.aimed
    return _open(Longitudinal.FORWARD if abs(error) < widest else Longitudinal.STOP, turn)


def _leave(view: StateView, block: Point) -> int:
    """Back off a block, turning the finger that touches it outwards."""
    aside = view.to_robot_frame(block)[0]
    return _open(Longitudinal.BACK, turn_towards(-aside, BACKING.off_axis))


def _block_between_fingers(view: StateView, others: Sequence[Point]) -> Point | None:
    """The block between the open fingers, if any, and if there is room to back off."""
    if not _has_wall_free_rear(view):
        return None
    return next((other for other in others if is_between_fingers(view, other)), None)


def _is_in_closing_range(local: Point) -> bool:
    return abs(local[0]) < SWEEP.closing_half_width and 0.0 < local[1] < SWEEP.closing_length


def _sweeps(view: StateView, error: float, obstacles: Sequence[Point], radius: float) -> bool:
    """Whether turning by `error` would push a block in front that is nearer than `radius`."""
    low, high = min(0.0, error) - SWEEP.margin, max(0.0, error) + SWEEP.margin
    for obstacle in obstacles:
        x, y = view.to_robot_frame(obstacle)
        if y > SWEEP.start and math.hypot(x, y) < radius and low < math.atan2(-x, y) < high:
            return True
    return False
