"""Goals of FixColour: the mismatched block in no region, each other in its own (appendix A.2.6)."""

from magical.experts.goals._moves import moves_in, moves_out
from magical.experts.planning import MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.tasks.fix_colour import mismatches


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Take the mismatched block out, and bring back any other that has left its region."""
    mismatched, moves = mismatches(view.scene), []
    for i, region in enumerate(view.scene.regions):
        if i in mismatched:
            moves += moves_out(view, strategy, [i])
        else:
            moves += moves_in(view, strategy, region, [i])
    return MovePlan(tuple(moves))


PLANNER = Planner(plan)
