"""Goals of FixColour: the mismatched block in no region, each other in its own (appendix A.2.6)."""

from magical.experts.goals._regions import missing_parts, moves_in, moves_out_of_all
from magical.experts.planning import Goals, Plan, Strategy
from magical.experts.state_view import StateView
from magical.scene import Scene


def plan(view: StateView, strategy: Strategy, last: Plan) -> Plan:
    """Take the mismatched block out, and bring back any other that has left its region."""
    moves = []
    pairs = zip(view.scene.blocks, view.scene.regions, strict=False)
    for i, (block, region) in enumerate(pairs):
        if block.colour == region.colour:
            moves += moves_in(view, strategy, region, [i])
        else:
            moves += moves_out_of_all(view, strategy, [i])
    return Plan(tuple(moves))


def unsolvable(scene: Scene) -> str:
    """Why the scene has no solution: blocks and regions are no pairs."""
    if missing := missing_parts(scene, regions=1, blocks=1):
        return missing
    if len(scene.blocks) == len(scene.regions):
        return ""
    return (
        f"expected one block for each goal region, found {len(scene.blocks)} blocks and "
        f"{len(scene.regions)} regions"
    )


GOALS = Goals(plan, unsolvable_fn=unsolvable)
