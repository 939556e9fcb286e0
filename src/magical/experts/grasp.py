"""Grasps: their geometry, and their costs from every side, for one block or for all.

A grasp has a side, the bearing at which the robot faces the block; a stand, where the robot is when
it holds the block; and a gate behind the stand, where the last straight approach begins. Costs are
approximate: the control steps that something takes, or its risk expressed in control steps.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magical.experts.geometry import (
    BACK_STEP,
    CONTACT_DISTANCE,
    DRIVE_STEP,
    DRIVING_CLEARANCE,
    HELD_DISTANCE,
    ROBOT_LIMIT,
    TURN_STEP,
    Floats,
    bearing,
    excess,
    is_within,
    project_on_segments,
    wrap_angle,
)
from magical.experts.planning import GRASP_SIDES
from magical.experts.state_view import StateView
from magical.scene.constants import BLOCK_SIZE
from magical.scene.geometry import Point, lengths

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

SIDES: Floats = wrap_angle(2 * math.pi * np.arange(float(GRASP_SIDES)) / GRASP_SIDES)  # rad
_GATE_DISTANCES: Floats = np.array(GATE_DISTANCES)


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
        if is_within(gate, ROBOT_LIMIT):
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
    gate_distances = _gate_distances(centres, ahead)
    gates, stands = centres - gate_distances * ahead, centres - HELD_DISTANCE * ahead
    walls = STAND_WALL_COST * _outside(stands, ROBOT_LIMIT)
    walls += GATE_WALL_COST * _outside(gates, ROBOT_LIMIT)
    # How far behind the block the straight approach passes nearest to each other block.
    offsets = others - centres  # (B, M, 2)
    passing = -(ahead @ offsets.swapaxes(1, 2))  # (B, S, M)
    passing = np.minimum(np.maximum(passing, HELD_DISTANCE), gate_distances)
    gaps = lengths(offsets[:, None] + passing[..., None] * ahead[:, None])
    missing = np.maximum(0.0, CONTACT_DISTANCE - gaps)
    to_finger = FINGER_OFFSET * ahead[:, ::-1] * (1.0, -1.0)  # (S, 2) to the right
    for finger in (centres + to_finger, centres - to_finger):  # (B, S, 2)
        walls += FINGER_WALL_COST * (_outside(finger, FINGER_LIMIT) > 0.0)
        missing += np.maximum(0.0, FINGER_ROOM - lengths(finger[..., None, :] - others))
    return Grasps(gates, stands, walls, NEIGHBOUR_COST * missing)


def make_mutual_grasps(blocks: Floats) -> Grasps:
    """The grasps of blocks (B, 2) from `SIDES`, each among the others."""
    grasps = make_grasps(blocks, SIDES, blocks)
    itself = np.arange(len(blocks))
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

    In addition to `SIDES`, the bearing straight from the robot to the block is considered.

    Args:
        view: the current state.
        block: the block's centre.
        goal: where it should go.
        others: the other blocks' centres.
        preferences: control steps (GRASP_SIDES,) that are added to the sides' costs.
        current: the side chosen before, which is kept unless another is clearly better.
    """
    sides = [bearing(view.position, block), *SIDES.tolist()]
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
    _, gaps = project_on_segments(np.array(view.position), gates[:, None], points)
    narrow = np.maximum(0.0, DRIVING_CLEARANCE - gaps)  # (S, M + 1)
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
    straight = bearing(view.position, block)
    distance = lengths(gates - view.position) + GATE_DISTANCES[0] - HELD_DISTANCE
    distance += DETOUR * narrow / DRIVING_CLEARANCE
    heading = np.arctan2(view.x - gates[:, 0], gates[:, 1] - view.y)
    turn = np.abs(wrap_angle(heading - view.angle)) + np.abs(wrap_angle(sides - heading))
    return np.where(
        np.abs(wrap_angle(straight - sides)) < CONE,
        _direct_approach_steps(view, block, straight),
        distance / DRIVE_STEP + turn / TURN_STEP,
    )


def _direct_approach_steps(view: StateView, block: Point, straight: float) -> float:
    distance = view.distance_to(block)
    turn = abs(wrap_angle(straight - view.angle))
    retreat = max(0.0, SWEEP_RADIUS - distance) if turn > MISAIMED else 0.0
    driven = distance - HELD_DISTANCE + 2 * retreat
    return driven / DRIVE_STEP + turn / TURN_STEP


def _carry_steps(stands: Floats, block: Point, sides: Floats, goal: Point) -> Floats:
    """Control steps (S,) to push or pull the block, held from each side, to its goal."""
    distance = math.dist(block, goal)
    to_goal = np.arctan2(stands[:, 0] - goal[0], goal[1] - stands[:, 1])
    push_turn = np.abs(wrap_angle(to_goal - sides)) / TURN_STEP
    pull_turn = np.abs(wrap_angle(bearing(goal, block) - sides)) / TURN_STEP
    return np.minimum(
        distance / DRIVE_STEP + CARRYING_TURN * push_turn,
        distance / BACK_STEP + CARRYING_TURN * pull_turn + PULL_STEPS,
    )


def _gate_distances(centres: Floats, ahead: Floats) -> Floats:
    """Units (B, S, 1) from blocks (B, 1, 2) to their gates, as in `gate_point`."""
    gates = centres - _GATE_DISTANCES[:, None, None, None] * ahead  # (distances, B, S, 2)
    fits = _outside(gates, ROBOT_LIMIT) <= 0.0
    fits[-1] = True
    first: Floats = _GATE_DISTANCES[fits.argmax(axis=0)][..., None]
    return first


def _outside(points: Floats, limit: float) -> Floats:
    """By how much the larger coordinate of points (..., 2) exceeds a limit, or 0."""
    beyond: Floats = excess(points, limit).max(axis=-1)
    return beyond
