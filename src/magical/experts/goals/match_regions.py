"""Goals of MatchRegions: all and only blocks of the region's colour inside (appendix A.2.3)."""

from magical.experts.goals._regions import missing_parts, moves_in, moves_out
from magical.experts.planning import Goals, Plan, Strategy
from magical.experts.state_view import StateView
from magical.scene import Scene


def plan(view: StateView, strategy: Strategy, last: Plan) -> Plan:
    """Bring targets in and distractors out."""
    region = view.scene.regions[0]
    targets = [i for i, block in enumerate(view.scene.blocks) if block.colour == region.colour]
    moves = moves_in(view, strategy, region, targets)
    return Plan((*moves, *moves_out(view, strategy, region, targets)))


def unsolvable(scene: Scene) -> str:
    """Why the scene has no solution: it lacks a target."""
    if missing := missing_parts(scene, regions=1, blocks=1):
        return missing
    colour = scene.regions[0].colour
    if any(block.colour == colour for block in scene.blocks):
        return ""
    return f"expected a {colour} block for the {colour} region, found none; add one"


GOALS = Goals(plan, unsolvable_fn=unsolvable)
