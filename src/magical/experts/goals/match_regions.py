"""Goals of MatchRegions: all and only blocks of the region's colour inside (appendix A.2.3)."""

from magical.experts.goals._moves import moves_in, moves_out
from magical.experts.planning import MovePlan, Planner, Strategy
from magical.experts.state_view import StateView


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring targets in and distractors out."""
    region = view.scene.regions[0]
    targets = [i for i, block in enumerate(view.scene.blocks) if block.colour == region.colour]
    distractors = [i for i in range(len(view.blocks)) if i not in targets]
    moves = moves_in(view, strategy, region, targets)
    return MovePlan((*moves, *moves_out(view, strategy, distractors)))


PLANNER = Planner(plan)
