"""The elements of planning: moves, a task's planner, and a demonstrator's strategy."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magical.experts.state_view import StateView
from magical.scene import Point, Region

GRASP_SIDES = 16  # evenly spaced bearings from which a grasp is considered
MAX_SIDE_COST = 4.0  # control steps; tuned
MAX_BLOCK_COST = 12.0  # control steps; tuned
PREFERRED_BLOCKS = 16  # with separate preferences; further ones share them. More than in any task
PLACEMENTS = 64  # numbers; more than any planner reads


@dataclass(frozen=True, slots=True)
class Move:
    """Bring a block (or the robot itself, if `block` is None) within `tolerance` of a goal."""

    goal: Point
    tolerance: float  # units
    block: int | None = None
    extra_cost: float = 0.0  # control steps added when moves are compared
    area: Region | None = None  # the move is also done once its block is in this


@dataclass(frozen=True, slots=True)
class MovePlan:
    """The moves still to make, in any order, and what keeps the next plan consistent."""

    moves: tuple[Move, ...] = ()
    places: tuple[Point, ...] = ()  # specific to the task: a line's places, the clusters' anchors


@dataclass(frozen=True, slots=True)
class Strategy:
    """The preferences in which demonstrators differ, sampled once per episode."""

    side_costs: tuple[float, ...]  # control steps, for grasping from each side
    block_costs: tuple[float, ...]  # control steps, for moving each block first
    placements: tuple[float, ...]  # in [0, 1): which places and directions are preferred

    @staticmethod
    def sample(rng: np.random.Generator) -> "Strategy":
        """Sample one demonstrator's preferences."""
        return Strategy(
            tuple((MAX_SIDE_COST * rng.random(GRASP_SIDES)).tolist()),
            tuple((MAX_BLOCK_COST * rng.random(PREFERRED_BLOCKS)).tolist()),
            tuple(rng.random(PLACEMENTS).tolist()),
        )


@dataclass(frozen=True, slots=True)
class Planner:
    """What an expert must know about a task: a function from a state to the moves still to make.

    Attributes:
        plan_fn: The moves still to make, from the state, the strategy and the last plan.
        solved_fn: Whether the task is solved; called often, so it should be cheap. When it is
            true, the expert releases the block that it holds. Default: never.
    """

    plan_fn: Callable[[StateView, Strategy, MovePlan], MovePlan]
    solved_fn: Callable[[StateView], bool] = lambda view: False
