"""Goals of FindDupe: the query block and a duplicate inside, no others (appendix A.2.5)."""

from magical.experts.goals._moves import moves_in, moves_out
from magical.experts.planning import MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.tasks.find_dupe import alike


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring in a duplicate, and the query block if it has left; take other blocks out."""
    region, query = view.scene.regions[0], len(view.blocks) - 1
    duplicates = sorted(alike(view.scene) - {query})
    inside = [i for i in duplicates if region.contains(*view.blocks[i])]
    others = [i for i in range(query) if i not in duplicates]
    moves = moves_in(view, strategy, region, (query, *(inside or duplicates)))
    return MovePlan((*moves, *moves_out(view, strategy, others)))


PLANNER = Planner(plan)
