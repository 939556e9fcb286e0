"""Goals of FindDupe: the query block and one like it inside, no others (appendix A.2.5)."""

from magical.experts.goals._regions import missing_parts, moves_in, moves_out
from magical.experts.planning import Goals, Plan, Strategy
from magical.experts.state_view import StateView
from magical.scene import Block, Scene


def plan(view: StateView, strategy: Strategy, last: Plan) -> Plan:
    """Bring in one of the duplicates, and the query block should it have left."""
    region, query = view.scene.regions[0], len(view.blocks) - 1
    duplicates = _duplicates(view.scene)
    inside = [i for i in duplicates if region.contains(*view.blocks[i])]
    moves = moves_in(view, strategy, region, (query, *(inside or duplicates)))
    return Plan((*moves, *moves_out(view, strategy, region, (query, *duplicates))))


def unsolvable(scene: Scene) -> str:
    """Why the scene has no solution: it lacks a duplicate of the query block."""
    if missing := missing_parts(scene, regions=1, blocks=2):
        return missing
    if _duplicates(scene):
        return ""
    query = scene.blocks[-1]
    return f"expected a second {query.colour} {query.shape} like the query, found none; add one"


def _duplicates(scene: Scene) -> list[int]:
    """The blocks with the shape and colour of the query block, which is the last."""
    *outside, query = scene.blocks
    return [i for i, block in enumerate(outside) if _kind(block) == _kind(query)]


def _kind(block: Block) -> tuple[str, str]:
    return block.shape, block.colour


GOALS = Goals(plan, unsolvable_fn=unsolvable)
