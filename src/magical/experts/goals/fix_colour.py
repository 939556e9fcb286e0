"""Goals of FixColour: the mismatched block in no region, each other in its own (appendix A.2.6)."""

from magical.experts.goals._moves import moves_in, moves_out
from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.tasks.fix_colour import mismatched


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Take the mismatched block out; return others to their regions, and others out of these."""
    odd = mismatched(view.scene)
    moves = moves_out(view, strategy, odd)
    for i, region in enumerate(view.scene.regions):
        if i not in odd:
            inside = [k for k, at in enumerate(view.blocks) if region.contains(*at) and k != i]
            moves += moves_in(view, strategy, region, [i]) + moves_out(view, strategy, inside)
    first: dict[int | None, Move] = {}
    for move in moves:  # the first move of a block decides
        first.setdefault(move.block, move)
    return MovePlan(tuple(first.values()))


PLANNER = Planner(plan)
