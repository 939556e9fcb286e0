"""Goals of MoveToCorner: the block within sqrt(2) / 2 of the top left corner (appendix A.2.1)."""

import math
from dataclasses import dataclass

from magical.experts.goals._regions import missing_parts
from magical.experts.planning import Goals, Move, Plan, Strategy
from magical.experts.state_view import StateView

CORNER = (-1.0, 1.0)  # units


@dataclass(frozen=True, slots=True)
class CornerSettings:
    """Where the block is brought."""

    done: float = 0.64  # units from the corner that are near enough; below 0.707 scores
    goal_limit: float = 0.82  # units: largest coordinate of a goal; tuned
    goal_range: float = 0.25  # units from there, in each coordinate, over which goals vary; tuned
    tolerance: float = 0.25  # units; tuned
    tolerance_range: float = 0.25  # units that are added at most; tuned


SETTINGS = CornerSettings()


def plan(view: StateView, strategy: Strategy, last: Plan) -> Plan:
    """Bring the block to a preferred place near the corner, as exactly as the strategy has it."""
    if math.dist(view.blocks[0], CORNER) < SETTINGS.done:
        return Plan()
    exactness, u, v = strategy.placements[:3]
    x = -SETTINGS.goal_limit + SETTINGS.goal_range * u
    y = SETTINGS.goal_limit - SETTINGS.goal_range * v
    return Plan((Move((x, y), SETTINGS.tolerance + SETTINGS.tolerance_range * exactness, 0),))


GOALS = Goals(plan, unsolvable_fn=lambda scene: missing_parts(scene, regions=0, blocks=1))
