"""What moves cost in all tasks: grasping, carrying, and setting a block down at a place."""

from dataclasses import dataclass

import numpy as np

from magical.experts.array_geometry import Floats, excess, lengths
from magical.experts.distances import BLOCK_SPACING
from magical.experts.motions import DRIVE_STEP
from magical.scene.geometry import Point


@dataclass(frozen=True, slots=True)
class MoveCosts:
    """What a move of a block is charged for."""

    move: float = 40.0  # control steps besides the way, for driving up and grasping; swept
    distance: float = 1.0 / DRIVE_STEP  # control steps per unit of way
    block: float = 150.0  # control steps per unit of missing room at the goal; tuned
    wall_limit: float = 0.85  # units: largest coordinate of a goal that costs nothing; tuned
    wall: float = 20.0  # control steps beyond it, where fingers do not open freely; tuned


MOVE = MoveCosts()


def place_costs(places: Floats, block: Point, others: Floats) -> Floats:
    """Control steps (P,) to bring a block to `places` (P, 2), and to set it down there.

    Args:
        places: Where it could go.
        block: Where it is.
        others: Centres (M, 2) of the other blocks, which need room beside it.
    """
    room = lengths(places[:, None] - others)  # (P, M)
    missing = np.maximum(0.0, BLOCK_SPACING - room).sum(axis=1)
    is_at_wall = excess(places, MOVE.wall_limit).any(axis=1)
    costs: Floats = MOVE.distance * lengths(places - block) + MOVE.block * missing
    return costs + MOVE.wall * is_at_wall
