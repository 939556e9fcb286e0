"""Goals of MatchRegions: all and only blocks of the region's colour inside (appendix A.2.3)."""

from magical.experts.goals._moves import moves_in, moves_out
from magical.experts.planning import MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.tasks.match_regions import targets


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring in the blocks of the region's colour, and take the others out."""
    chosen = targets(view.scene)
    others = [i for i in range(len(view.blocks)) if i not in chosen]
    moves = moves_in(view, strategy, view.scene.regions[0], sorted(chosen))
    return MovePlan((*moves, *moves_out(view, strategy, others)))


PLANNER = Planner(plan)
