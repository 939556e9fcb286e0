"""What a grasp costs from every side, for one block or for all, in one vectorised model.

Costs are about the control steps that something takes, or what it risks in control steps. Walls and
other blocks hinder the robot on its straight approach and the fingers around the block.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magical.experts.array_geometry import (
    Floats,
    excess,
    lengths,
    project_on_segments,
    wrap_angles,
)
from magical.experts.distances import (
    CONTACT_DISTANCE,
    DRIVING_CLEARANCE,
    HELD_DISTANCE,
    ROBOT_LIMIT,
)
from magical.experts.grasp import GATE_DISTANCES, GRASP
from magical.experts.motions import BACK_STEP, DRIVE_STEP, TURN_STEP
from magical.experts.planning import GRASP_SIDES
from magical.experts.state_view import StateView, bearing, wrap_angle
from magical.scene.geometry import Point


@dataclass(frozen=True, slots=True)
class GraspCostSettings:
    """What a grasp is charged for."""

    stand_wall: float = 300.0  # control steps per unit that the stand is outside; tuned
    gate_wall: float = 40.0  # control steps per unit that the gate is outside; tuned
    finger_wall: float = 8.0  # control steps per finger outside; tuned
    block: float = 150.0  # control steps per unit of missing room to a block; tuned
    path: float = 15.0  # control steps per unit of missing room on the way to the gate; tuned
    detour: float = 0.5  # units of driving around the block itself, at most; tuned
    misaimed: float = 0.4  # rad off the block at which it has to turn; tuned
    start_steps: float = 2.0  # control steps that any drive takes in addition; tuned
    turn: float = 1.3  # of TURN_STEP's time that turning with a block takes; tuned
    pull_steps: float = 2.0  # control steps that pulling takes in addition; tuned
    switch: float = 6.0  # control steps that another side must be better by; tuned


COST = GraspCostSettings()

SIDES: Floats = wrap_angles(2 * math.pi * np.arange(float(GRASP_SIDES)) / GRASP_SIDES)  # rad
_DISTANCES: Floats = np.array(GATE_DISTANCES)


@dataclass(frozen=True, slots=True)
class Grasps:
    """Grasps of B blocks from S sides each."""

    blocks: Floats  # (B, 1, 2) centres
    ahead: Floats  # (S, 2) unit vectors from the robot towards the block
    gate_distances: Floats  # (B, S, 1) units from block to gate
    gates: Floats  # (B, S, 2)
    stands: Floats  # (B, S, 2)

    @staticmethod
    def of(blocks: Floats, sides: Floats) -> "Grasps":
        """The grasps of blocks (B, 2) at bearings (S,)."""
        ahead = np.array((-np.sin(sides), np.cos(sides))).T
        centres = blocks[:, None]
        distances = _gate_distances(centres, ahead)
        stands = centres - HELD_DISTANCE * ahead
        return Grasps(centres, ahead, distances, centres - distances * ahead, stands)


@dataclass(frozen=True, slots=True)
class Obstruction:
    """What is in the way of grasping each of B blocks from each of S sides, in control steps."""

    walls: Floats  # (B, S)
    blocks: Floats  # (B, S, M) for each of M other blocks


def obstruction(grasps: Grasps, others: Floats) -> Obstruction:
    """What walls and other blocks, at `others` (M, 2), cost each grasp."""
    ahead = grasps.ahead
    to_finger = GRASP.finger_offset * ahead[:, ::-1] * (1.0, -1.0)  # (S, 2) to the right
    fingers = grasps.blocks + to_finger, grasps.blocks - to_finger
    walls = COST.stand_wall * _outside(grasps.stands, ROBOT_LIMIT)
    walls += COST.gate_wall * _outside(grasps.gates, ROBOT_LIMIT)
    # How far behind the block the straight approach passes nearest to each other block.
    offsets = others - grasps.blocks  # (B, M, 2)
    passing = -(ahead @ offsets.swapaxes(1, 2))  # (B, S, M)
    passing = np.minimum(np.maximum(passing, HELD_DISTANCE), grasps.gate_distances)
    gaps = lengths(offsets[:, None] + passing[..., None] * ahead[:, None])
    missing = np.maximum(0.0, CONTACT_DISTANCE - gaps)
    for finger in fingers:  # (B, S, 2)
        walls += COST.finger_wall * (_outside(finger, GRASP.finger_limit) > 0.0)
        missing += np.maximum(0.0, GRASP.finger_room - lengths(finger[..., None, :] - others))
    return Obstruction(walls, COST.block * missing)


def mutual_obstruction(blocks: Floats) -> Obstruction:
    """What is in the way of grasping each of `blocks` (B, 2) from `SIDES`, the others included."""
    found = obstruction(Grasps.of(blocks, SIDES), blocks)
    itself = np.arange(len(blocks))
    found.blocks[itself, :, itself] = 0.0
    return found


def best_side(
    view: StateView,
    block: Point,
    goal: Point,
    others: Sequence[Point],
    preferences: Sequence[float],
    current: float | None = None,
) -> tuple[float, float]:
    """The side to grasp a block from, and about how many control steps until it is at `goal`.

    Besides `SIDES`, the bearing from the robot straight to the block is considered.

    Args:
        view: The present state.
        block: The block's centre.
        goal: Where it should go.
        others: The other blocks' centres.
        preferences: Control steps (GRASP_SIDES,) that are added to the sides' costs.
        current: The side chosen before, which is left only for a clearly better one.
    """
    sides = [bearing(view.position, block), *SIDES.tolist()]
    kept = [] if current is None else [current]
    costs = grasp_costs(view, block, goal, others, np.array(sides + kept))
    costs[: len(sides)] += (preferences[0], *preferences)
    best = int(costs[: len(sides)].argmin())
    if current is not None and costs[best] >= costs[-1] - COST.switch:
        return current, float(costs[-1])
    return sides[best], float(costs[best])


def grasp_costs(
    view: StateView, block: Point, goal: Point, others: Sequence[Point], sides: Floats
) -> Floats:
    """Control steps (S,) until a block, grasped from each of `sides` (S,), is at its goal."""
    grasps, points = Grasps.of(np.array([block]), sides), np.array((*others, block))  # (M + 1, 2)
    hindrance = obstruction(grasps, points[:-1])
    gates = grasps.gates[0]  # (S, 2)
    _, gaps = project_on_segments(np.array(view.position), gates[:, None], points)
    narrow = np.maximum(0.0, DRIVING_CLEARANCE - gaps)  # (S, M + 1)
    costs: Floats = hindrance.walls[0] + hindrance.blocks[0].sum(axis=-1)
    costs += COST.path * narrow[:, :-1].sum(axis=-1)
    costs += _approach_steps(view, block, sides, gates, narrow[:, -1])
    costs += _carry_steps(grasps.stands[0], block, sides, goal)
    return costs


def _approach_steps(
    view: StateView, block: Point, sides: Floats, gates: Floats, narrow: Floats
) -> Floats:
    """Control steps (S,) until the robot holds the block, straight or by way of each gate.

    `narrow` (S,) is by how many units the block itself is in the way to each gate.
    """
    straight = bearing(view.position, block)
    distance = lengths(gates - view.position) + GRASP.gate - HELD_DISTANCE
    distance += COST.detour * narrow / DRIVING_CLEARANCE
    heading = np.arctan2(view.x - gates[:, 0], gates[:, 1] - view.y)
    turn = np.abs(wrap_angles(heading - view.angle)) + np.abs(wrap_angles(sides - heading))
    steps: Floats = np.where(
        np.abs(wrap_angles(straight - sides)) < GRASP.cone,
        _direct_approach_steps(view, block, straight),
        COST.start_steps + distance / DRIVE_STEP + turn / TURN_STEP,
    )
    return steps


def _direct_approach_steps(view: StateView, block: Point, straight: float) -> float:
    distance = view.distance_to(block)
    turn = abs(wrap_angle(straight - view.angle))
    retreat = max(0.0, GRASP.sweep - distance) if turn > COST.misaimed else 0.0
    driven = distance - HELD_DISTANCE + 2 * retreat
    return COST.start_steps + driven / DRIVE_STEP + turn / TURN_STEP


def _carry_steps(stands: Floats, block: Point, sides: Floats, goal: Point) -> Floats:
    """Control steps (S,) to push or pull the block, held from each side, to its goal."""
    distance = math.dist(block, goal)
    to_goal = np.arctan2(stands[:, 0] - goal[0], goal[1] - stands[:, 1])
    push_turn = np.abs(wrap_angles(to_goal - sides)) / TURN_STEP
    pull_turn = np.abs(wrap_angles(bearing(goal, block) - sides)) / TURN_STEP
    steps: Floats = np.minimum(
        distance / DRIVE_STEP + COST.turn * push_turn,
        distance / BACK_STEP + COST.turn * pull_turn + COST.pull_steps,
    )
    return steps


def _gate_distances(centres: Floats, ahead: Floats) -> Floats:
    """Units (B, S, 1) from blocks (B, 1, 2) to their gates, the same as `gate_point` for each."""
    gates = centres - _DISTANCES[:, None, None, None] * ahead  # (distances, B, S, 2)
    fits = _outside(gates, ROBOT_LIMIT) <= 0.0
    fits[-1] = True
    first: Floats = _DISTANCES[fits.argmax(axis=0)][..., None]
    return first


def _outside(points: Floats, limit: float) -> Floats:
    """By how much the larger coordinate of points (..., 2) exceeds a limit, or 0."""
    beyond: Floats = excess(points, limit).max(axis=-1)
    return beyond
