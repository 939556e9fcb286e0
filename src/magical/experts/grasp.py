"""Grasping a block: from which side, how to drive there, and how to leave it or get unstuck.

A grasp has a side, the bearing at which the robot faces the block; a stand, where the robot is when
it holds the block; and a gate behind the stand, where the last straight approach begins. Costs are
approximate: the control steps that something takes, or its risk expressed in control steps.

One control step of turning turns the robot by about 0.3 rad, and there is no half step, so a
heading is corrected only if the error is worth a step, and judged at the angle at which the current
turn will stop.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magical.experts import geometry as g
from magical.experts.geometry import Floats
from magical.experts.paths import is_clear, next_waypoint
from magical.experts.planning import GRASP_SIDES
from magical.experts.state_view import StateView
from magical.scene import NOOP, Action, Gripper, Longitudinal, Point, Turn, lengths
from magical.scene.constants import BLOCK_SIZE

# Where the fingers catch a block, and what they hit around it.
REACH = 0.42  # units ahead up to which closing fingers catch a block; measured
HALF_WIDTH = 0.12  # units to the side up to which they do; measured, for near blocks
SLIP = 0.03  # units beyond both that a held block may slip; tuned
# Units from block to gate: the first for which the walls leave room; tuned.
GATE_DISTANCES = (0.56, 0.52, 0.48, 0.44, 0.4)
CONE = 0.5  # rad off its side within which a block is approached directly; tuned
SWEEP_RADIUS = 0.45  # units: turning on the spot hits nearer blocks hard; tuned
FINGER_OFFSET = 0.18  # units from a block's centre to the fingers around it; measured
FINGER_ROOM = BLOCK_SIZE + 0.03  # units from a finger to other blocks; margin tuned
FINGER_LIMIT = 0.98  # units: largest coordinate of a finger; tuned

STAND_WALL_COST = 300.0  # control steps per unit that the stand is outside; tuned
GATE_WALL_COST = 40.0  # control steps per unit that the gate is outside; tuned
FINGER_WALL_COST = 8.0  # control steps per finger outside; tuned
NEIGHBOUR_COST = 150.0  # control steps per unit of missing room to a block; tuned
PATH_COST = 15.0  # control steps per unit of missing room on the way to the gate; tuned
DETOUR = 0.5  # units of driving around the block itself, at most; tuned
MISAIMED = 0.4  # rad off the block above which turning needs room; tuned
CARRYING_TURN = 1.3  # factor on the time that turning takes with a block; tuned
PULL_STEPS = 2.0  # additional control steps that pulling takes; tuned
SIDE_SWITCH_STEPS = 6.0  # control steps by which another side must be better; tuned

# When a heading is corrected, and when the robot drives while it turns.
BRAKING = 27.0  # rad / s^2 at which an empty robot stops turning; measured: 26 to 28
FAR_DISTANCE = 0.5  # units: further away, heading errors may grow to a whole step; tuned
FAR_ERROR = 0.8 * g.TURN_STEP  # rad: larger errors are corrected, far away; tuned
NEAR_ERROR = 0.55 * g.TURN_STEP  # rad: larger errors are corrected, close by; tuned
AIMED = 0.35  # rad: heading error up to which the robot drives on; tuned
ARC = 1.1  # rad: the same if there is room for an arc; tuned
ARC_DISTANCE = 0.6  # units: such room, twice the arc's radius (measured: 0.32)

# How a block is brought between the open fingers.
ARRIVED = 0.16  # units from the gate at which the robot has reached it; tuned
DIRECT = GATE_DISTANCES[0] + 0.12  # units: nearer blocks are approached without a path; tuned
STRAIGHT_CLEARANCE = g.DRIVING_CLEARANCE - 0.04  # units to others on the straight approach; tuned
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

SIDES: Floats = g.wrap_angle(2 * math.pi * np.arange(float(GRASP_SIDES)) / GRASP_SIDES)  # rad
_GATE_DISTANCES: Floats = np.array(GATE_DISTANCES)[:, None, None, None]
_ESCAPES = (
    (Longitudinal.BACK, Turn.STRAIGHT),
    (Longitudinal.BACK, Turn.LEFT),
    (Longitudinal.BACK, Turn.RIGHT),
    (Longitudinal.FORWARD, Turn.LEFT),
    (Longitudinal.FORWARD, Turn.RIGHT),
)


def is_between_fingers(view: StateView, block: Point, is_held: bool = False) -> bool:
    """Whether the fingers hold the block, or would hold it on closing."""
    x, y = view.to_robot_frame(block)
    slip = SLIP if is_held else 0.0
    return abs(x) < HALF_WIDTH + slip and 0.0 < y < REACH + slip


def point_behind(block: Point, side: float, distance: float) -> Point:
    """The point from which the block is `distance` away at bearing `side`."""
    return block[0] + math.sin(side) * distance, block[1] - math.cos(side) * distance


def gate_point(block: Point, side: float) -> Point:
    """Where the last straight approach begins: nearer if a wall leaves no room."""
    for distance in GATE_DISTANCES:
        gate = point_behind(block, side, distance)
        if g.is_within(gate, g.ROBOT_LIMIT):
            break
    return gate


class Grasps(NamedTuple):
    """Grasps of B blocks from S sides, and the costs for each of the walls and M other blocks."""

    gates: Floats  # (B, S, 2)
    stands: Floats  # (B, S, 2)
    wall_costs: Floats  # (B, S) control steps
    block_costs: Floats  # (B, S, M) control steps


def make_grasps(blocks: Floats, sides: Floats, others: Floats) -> Grasps:
    """The grasps of blocks (B, 2) at bearings (S,) among others (M, 2).

    Walls and other blocks hinder the robot on its straight approach and the fingers around the
    block.
    """
    ahead = np.array((-np.sin(sides), np.cos(sides))).T  # (S, 2) from the robot towards the block
    centres = blocks[:, None]  # (B, 1, 2)
    fits = _outside(centres - _GATE_DISTANCES * ahead, g.ROBOT_LIMIT) <= 0.0  # (distances, B, S)
    fits[-1] = True
    gate_distances = _GATE_DISTANCES[fits.argmax(axis=0), 0, 0]  # (B, S, 1), as in `gate_point`
    gates, stands = centres - gate_distances * ahead, centres - g.HELD_DISTANCE * ahead
    walls = STAND_WALL_COST * _outside(stands, g.ROBOT_LIMIT)
    walls += GATE_WALL_COST * _outside(gates, g.ROBOT_LIMIT)
    # How far behind the block the straight approach passes nearest to each other block.
    offsets = others - centres  # (B, M, 2)
    passing = -(ahead @ offsets.swapaxes(1, 2))  # (B, S, M)
    passing = np.minimum(np.maximum(passing, g.HELD_DISTANCE), gate_distances)
    gaps = lengths(offsets[:, None] + passing[..., None] * ahead[:, None])
    missing = np.maximum(0.0, g.CONTACT_DISTANCE - gaps)
    to_finger = FINGER_OFFSET * ahead[:, ::-1] * (1.0, -1.0)  # (S, 2) to the right
    for finger in (centres + to_finger, centres - to_finger):  # (B, S, 2)
        walls += FINGER_WALL_COST * (_outside(finger, FINGER_LIMIT) > 0.0)
        missing += np.maximum(0.0, FINGER_ROOM - lengths(finger[..., None, :] - others))
    return Grasps(gates, stands, walls, NEIGHBOUR_COST * missing)


def make_mutual_grasps(blocks: Floats) -> Grasps:
    """The grasps of blocks (B, 2) from `SIDES`, each among the others."""
    grasps, itself = make_grasps(blocks, SIDES, blocks), np.arange(len(blocks))
    grasps.block_costs[itself, :, itself] = 0.0
    return grasps


def best_side(
    view: StateView,
    block: Point,
    goal: Point,
    others: Sequence[Point],
    preferences: Sequence[float],
    current: float | None = None,
) -> tuple[float, float]:
    """The side to grasp a block from, and the approximate control steps until it is at `goal`.

    In addition to `SIDES`, the bearing straight from the robot to the block is considered. The
    `preferences` (GRASP_SIDES,) in control steps are added to the sides' costs. The `current` side
    is kept unless another is clearly better.
    """
    sides = [g.bearing(view.position, block), *SIDES.tolist()]
    kept = [] if current is None else [current]
    costs = grasp_costs(view, block, goal, others, np.array(sides + kept))
    costs[: len(sides)] += (preferences[0], *preferences)
    best = int(costs[: len(sides)].argmin())
    if current is not None and costs[best] >= costs[-1] - SIDE_SWITCH_STEPS:
        return current, float(costs[-1])
    return sides[best], float(costs[best])


def grasp_costs(
    view: StateView, block: Point, goal: Point, others: Sequence[Point], sides: Floats
) -> Floats:
    """Control steps (S,) until a block, grasped from each of `sides` (S,), is at its goal."""
    points = np.array((*others, block))  # (M + 1, 2)
    grasps = make_grasps(points[-1:], sides, points[:-1])
    gates = grasps.gates[0]  # (S, 2)
    _, gaps = g.project_on_segments(np.array(view.position), gates[:, None], points)
    narrow = np.maximum(0.0, g.DRIVING_CLEARANCE - gaps)  # (S, M + 1)
    costs: Floats = grasps.wall_costs[0] + grasps.block_costs[0].sum(axis=-1)
    costs += PATH_COST * narrow[:, :-1].sum(axis=-1)
    costs += _approach_steps(view, block, sides, gates, narrow[:, -1])
    costs += _carry_steps(grasps.stands[0], block, sides, goal)
    return costs


def _approach_steps(
    view: StateView, block: Point, sides: Floats, gates: Floats, narrow: Floats
) -> Floats:
    """Control steps (S,) until the robot holds the block, straight or by way of each gate.

    `narrow` (S,): units by which the block itself obstructs the way to each gate.
    """
    straight, away = g.bearing(view.position, block), view.distance_to(block)
    turn = abs(g.wrap_angle(straight - view.angle))
    retreat = max(0.0, SWEEP_RADIUS - away) if turn > MISAIMED else 0.0
    direct = (away - g.HELD_DISTANCE + 2 * retreat) / g.DRIVE_STEP + turn / g.TURN_STEP
    distance = lengths(gates - view.position) + GATE_DISTANCES[0] - g.HELD_DISTANCE
    distance += DETOUR * narrow / g.DRIVING_CLEARANCE
    heading = np.arctan2(view.x - gates[:, 0], gates[:, 1] - view.y)
    turns = np.abs(g.wrap_angle(heading - view.angle)) + np.abs(g.wrap_angle(sides - heading))
    by_gate = distance / g.DRIVE_STEP + turns / g.TURN_STEP
    return np.where(np.abs(g.wrap_angle(straight - sides)) < CONE, direct, by_gate)


def _carry_steps(stands: Floats, block: Point, sides: Floats, goal: Point) -> Floats:
    """Control steps (S,) to push or pull the block, held from each side, to its goal."""
    distance = math.dist(block, goal)
    to_goal = np.arctan2(stands[:, 0] - goal[0], goal[1] - stands[:, 1])
    push_turn = np.abs(g.wrap_angle(to_goal - sides)) / g.TURN_STEP
    pull_turn = np.abs(g.wrap_angle(g.bearing(goal, block) - sides)) / g.TURN_STEP
    return np.minimum(
        distance / g.DRIVE_STEP + CARRYING_TURN * push_turn,
        distance / g.BACK_STEP + CARRYING_TURN * pull_turn + PULL_STEPS,
    )


def _outside(points: Floats, limit: float) -> Floats:
    """By how much the larger coordinate of points (..., 2) exceeds a limit, or 0."""
    beyond: Floats = g.excess(points, limit).max(axis=-1)
    return beyond


def travel(view: StateView, goal: Point, obstacles: Sequence[Point], push_aside: bool) -> int:
    """The action that drives to a point around blocks, or pushes them aside."""
    clearance = g.CONTACT_DISTANCE if push_aside else g.DRIVING_CLEARANCE
    point = next_waypoint(view.position, goal, obstacles, clearance, view.angle)
    error = _heading_error(view, g.bearing(view.position, point))
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
    view: StateView, block: Point, side: float, others: Sequence[Point], push_aside: bool
) -> int:
    """The action that brings the block between the open fingers at bearing `side`."""
    gate = gate_point(block, side)
    arrived = 2 * ARRIVED if push_aside else ARRIVED
    if view.distance_to(gate) > arrived and not _is_direct(view, block, side, others):
        return travel(view, gate, (*others, block), push_aside)
    return _close_in(view, block, others, push_aside)


def _is_direct(view: StateView, block: Point, side: float, others: Sequence[Point]) -> bool:
    """Whether the robot can drive straight at the block without passing its gate."""
    straight = g.bearing(view.position, block)
    crowded = any(math.dist(block, other) < g.WORKING_DISTANCE for other in others)
    if abs(g.wrap_angle(straight - side)) > (CROWDED_CONE if crowded else CONE):
        return False
    if view.distance_to(block) < DIRECT:
        return True
    stand = point_behind(block, straight, g.HELD_DISTANCE)
    return is_clear(view.position, stand, others, STRAIGHT_CLEARANCE)


def _close_in(view: StateView, block: Point, others: Sequence[Point], push_aside: bool) -> int:
    """Drive straight at the block; back off first if a turn would push something."""
    away = view.distance_to(block)
    error = _heading_error(view, g.bearing(view.position, block))
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
    if abs(g.wrap_angle(g.bearing(view.position, block) - side)) < CONE:
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
    """The action that drives a stuck robot away: backwards, at later attempts in other ways.

    `with_block` pulls the held block along instead of releasing it.
    """
    if with_block:
        return Action(Longitudinal.BACK, Turn.STRAIGHT, Gripper.CLOSED).id
    return _open(*_ESCAPES[(attempt - 1) % len(_ESCAPES)])


def _heading_error(view: StateView, heading: float) -> float:
    """Radians left to turn, counter-clockwise, once the current turn has come to rest."""
    stopping = view.spin * abs(view.spin) / (2 * BRAKING)
    return g.wrap_angle(heading - view.angle - stopping)


def _turn_towards(error: float, threshold: float) -> Turn:
    """The turn that reduces a heading error larger than a threshold."""
    if error > threshold:
        return Turn.LEFT
    return Turn.RIGHT if error < -threshold else Turn.STRAIGHT


def _can_back(view: StateView, obstacles: Sequence[Point] = ()) -> bool:
    """Whether there is room behind the robot, at walls and at the obstacles."""
    rear = view.point_ahead(-REAR)
    return g.is_within(rear, REAR_LIMIT) and all(
        math.dist(rear, other) > g.CONTACT_DISTANCE or view.to_robot_frame(other)[1] > 0
        for other in obstacles
    )


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
    if not _can_back(view):
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
