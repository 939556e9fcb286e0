"""Grasps: where the robot stands, where its approach begins, when fingers hold a block.

A grasp has a side, the bearing at which the robot faces the block; a stand, where the robot is when
it holds the block; and a gate behind the stand, where the last straight approach begins.
"""

import math
from dataclasses import dataclass

from magical.experts.distances import ROBOT_LIMIT
from magical.experts.state_view import StateView, is_within
from magical.scene.constants import BLOCK_SIZE
from magical.scene.geometry import Point


@dataclass(frozen=True, slots=True)
class GraspSettings:
    """The geometry of a grasp."""

    reach: float = 0.42  # units ahead up to which closing fingers catch a block; measured
    half_width: float = 0.12  # units to the side up to which they do; measured, for near blocks
    slip: float = 0.03  # units beyond both that a held block may slip; tuned
    gate: float = 0.56  # units from block to gate; tuned
    nearest_gate: float = 0.42  # units: the gate comes this near where there is a wall; tuned
    gate_step: float = 0.04  # units between the distances tried; tuned
    cone: float = 0.5  # rad off its side within which a block is approached directly; tuned
    sweep: float = 0.45  # units: turning on the spot hits a nearer block badly; tuned
    finger_offset: float = 0.18  # units from a block's centre to the fingers around it; measured
    finger_room: float = BLOCK_SIZE + 0.03  # units from a finger to other blocks; margin tuned
    finger_limit: float = 0.98  # units: largest coordinate of a finger; tuned


GRASP = GraspSettings()


def _gate_distances() -> tuple[float, ...]:
    distances = [GRASP.gate]
    while distances[-1] > GRASP.nearest_gate:
        distances.append(distances[-1] - GRASP.gate_step)
    return tuple(distances)


GATE_DISTANCES = _gate_distances()  # units from block to gate, in the order they are tried


def is_between_fingers(view: StateView, block: Point, is_held: bool = False) -> bool:
    """Whether the fingers hold the block, or would on closing."""
    x, y = view.to_robot_frame(block)
    slip = GRASP.slip if is_held else 0.0
    return abs(x) < GRASP.half_width + slip and 0.0 < y < GRASP.reach + slip


def point_behind(block: Point, side: float, distance: float) -> Point:
    """The point from which the block is `distance` away at bearing `side`."""
    return block[0] + math.sin(side) * distance, block[1] - math.cos(side) * distance


def gate_point(block: Point, side: float) -> Point:
    """Where the last straight approach begins: nearer where a wall leaves no room."""
    for distance in GATE_DISTANCES:
        gate = point_behind(block, side, distance)
        if is_within(gate, ROBOT_LIMIT):
            break
    return gate
