"""Goals of MoveToCorner: the block within sqrt(2) / 2 of the top left corner (appendix A.2.1)."""

import math

from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.tasks.move_to_corner import GOAL

DONE = 0.64  # units from the corner that are near enough; full score below 0.707
GOAL_LIMIT = 0.82  # units: largest coordinate of a goal; tuned
GOAL_RANGE = 0.25  # units from there, in each coordinate, over which goals vary; tuned
TOLERANCE = 0.25  # units; tuned
TOLERANCE_RANGE = 0.25  # units added at most; tuned


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring the block to a preferred place near the corner, with a preferred tolerance."""
    if math.dist(view.blocks[0], GOAL) < DONE:
        return MovePlan()
    looseness, u, v = strategy.placements[:3]
    goal = GOAL_RANGE * u - GOAL_LIMIT, GOAL_LIMIT - GOAL_RANGE * v
    return MovePlan((Move(goal, TOLERANCE + TOLERANCE_RANGE * looseness, 0),))


PLANNER = Planner(plan)
