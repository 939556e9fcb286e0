"""Goals of the tasks about goal regions: drive in, bring blocks in, take blocks out."""

import math
from collections.abc import Iterable, Sequence

from magical.experts.goals import Goals, Move, Plan, Style, register_goals
from magical.experts.paths import gap
from magical.experts.sight import Sight, inside
from magical.scene import Colour, Region, Scene
from magical.scene.geometry import Point

MARGIN = 0.12  # units inside a region's edge (outside, for blocks that leave) that are aimed at
TOLERANCE = 0.08  # units
ROOM = 0.27  # units between the centres of two blocks side by side
TICKS = tuple(-0.84 + 0.12 * i for i in range(15))
ARENA = Region(Colour.BLUE, TICKS[0], TICKS[-1], TICKS[-1] - TICKS[0], TICKS[-1] - TICKS[0])
CORNER = (-0.82, 0.82)
LIKING = 6.0  # control steps by which a unit further from where a demonstrator likes blocks counts
LIKING_OUTSIDE = 5.0  # the same for blocks that must leave


def move_to_corner(sight: Sight, style: Style, plan: Plan) -> Plan:
    """MoveToCorner: the block within sqrt(2)/2 of the top left corner (appendix A.2.1)."""
    reach = 0.25 + 0.25 * style.places[0]
    if math.dist(sight.blocks[0], (-1.0, 1.0)) < 0.64:
        return Plan()
    goal = (CORNER[0] + 0.25 * style.places[1], CORNER[1] - 0.25 * style.places[2])
    return Plan((Move(goal, reach, 0),))


def move_to_region(sight: Sight, style: Style, plan: Plan) -> Plan:
    """MoveToRegion: the robot's centre inside the region (appendix A.2.2)."""
    region = sight.scene.regions[0]
    if _inset(region, 0.06).contains(sight.x, sight.y):
        return Plan()
    depth = 0.09 + 0.15 * style.places[2]  # how far inside it stops
    goal = _liked(style, _inset(region, depth + 0.05), 0)
    return Plan((Move(goal, 0.06, area=_inset(region, depth)),))


def match_regions(sight: Sight, style: Style, plan: Plan) -> Plan:
    """MatchRegions: all and only blocks of the region's colour inside (appendix A.2.3)."""
    region = sight.scene.regions[0]
    wanted = [i for i, b in enumerate(sight.scene.blocks) if b.colour == region.colour]
    return Plan((*_ins(sight, style, region, wanted), *_outs(sight, style, region, wanted)))


def find_dupe(sight: Sight, style: Style, plan: Plan) -> Plan:
    """FindDupe: the query block (the last) and one like it inside, no others (appendix A.2.5)."""
    region = sight.scene.regions[0]
    query = len(sight.blocks) - 1
    like = same_as(sight, query)
    within = [i for i in like if region.contains(*sight.blocks[i])]
    wanted = (query, *(within or like))
    moves = _ins(sight, style, region, wanted)
    return Plan((*moves, *_outs(sight, style, region, (query, *like))))


def same_as(sight: Sight, query: int) -> list[int]:
    """The other blocks with the same shape and colour."""
    blocks = sight.scene.blocks
    key = blocks[query].shape, blocks[query].colour
    return [i for i, b in enumerate(blocks) if i != query and (b.shape, b.colour) == key]


def fix_colour(sight: Sight, style: Style, plan: Plan) -> Plan:
    """FixColour: the mismatched block in no region, each other in its own (appendix A.2.6)."""
    moves: list[Move] = []
    regions = sight.scene.regions
    for i, (block, own) in enumerate(zip(sight.scene.blocks, regions, strict=False)):
        if block.colour == own.colour:
            moves += _ins(sight, style, own, (i,))
        elif any(_inset(region, -0.02).contains(*sight.blocks[i]) for region in regions):
            moves.append(Move(_free_place(sight, style, i), TOLERANCE, i))
    return Plan(tuple(moves))


def _ins(sight: Sight, style: Style, region: Region, wanted: Iterable[int]) -> list[Move]:
    outside = [i for i in wanted if not _inset(region, 0.02).contains(*sight.blocks[i])]
    area = _inset(region, 0.04)
    return [Move(_place_in(sight, style, region, i), TOLERANCE, i, area=area) for i in outside]


def _outs(sight: Sight, style: Style, region: Region, wanted: Iterable[int]) -> list[Move]:
    unwanted = set(range(len(sight.blocks))).difference(wanted)
    inner = [i for i in unwanted if _inset(region, -0.02).contains(*sight.blocks[i])]
    return [Move(_free_place(sight, style, i), TOLERANCE, i) for i in inner]


def _inset(region: Region, margin: float) -> Region:
    """The region made smaller on every side, but not to nothing."""
    across = min(margin, region.width / 2 - 0.01)
    down = min(margin, region.height / 2 - 0.01)
    return Region(
        region.colour,
        region.x + across,
        region.y - down,
        region.height - 2 * down,
        region.width - 2 * across,
    )


def _nearest(region: Region, point: Point) -> Point:
    """The point of a region nearest to a point."""
    x = min(max(point[0], region.x), region.x + region.width)
    y = min(max(point[1], region.y - region.height), region.y)
    return x, y


def _place_in(sight: Sight, style: Style, region: Region, block: int) -> Point:
    """Where in a region to bring a block: near, liked, and clear of the blocks already there."""
    inner = _inset(region, MARGIN)
    start, others = sight.blocks[block], _others(sight, block)
    liked = _liked(style, inner, block)
    steps = (0.0, 0.25, 0.5, 0.75, 1.0)
    places = [_nearest(inner, start)]
    places += [
        (inner.x + u * inner.width, inner.y - v * inner.height) for u in steps for v in steps
    ]
    return min(places, key=lambda p: _cost(p, start, others) + LIKING * math.dist(p, liked))


def _free_place(sight: Sight, style: Style, block: int) -> Point:
    """Where to bring a block that must leave all regions: near, liked, clear of other blocks."""
    wide = [_inset(region, -MARGIN) for region in sight.scene.regions]
    start, others = sight.blocks[block], _others(sight, block)
    places = [
        place
        for place in ((x, y) for x in TICKS for y in TICKS)
        if not any(region.contains(*place) for region in wide)
    ]
    liked = _liked(style, ARENA, block)

    def cost(place: Point) -> float:
        liking = LIKING_OUTSIDE * math.dist(place, liked)
        return _cost(place, start, others) + _along(place, start, others) + liking

    return min(places or [start], key=cost)


def _liked(style: Style, region: Region, block: int) -> Point:
    """Where in a region a demonstrator would like to have a block."""
    u, v = (style.places[(2 * block + i) % len(style.places)] for i in (0, 1))
    return region.x + u * region.width, region.y - v * region.height


def _others(sight: Sight, block: int) -> list[Point]:
    return [other for i, other in enumerate(sight.blocks) if i != block]


def _cost(place: Point, start: Point, others: Sequence[Point]) -> float:
    """Control steps, about, that a place costs more than the block's own."""
    cost = 10.0 * math.dist(place, start) + (0.0 if inside(place, 0.8) else 4.0)
    for other in others:
        cost += 150.0 * max(0.0, ROOM - math.dist(place, other))
    return cost


def _along(place: Point, start: Point, others: Sequence[Point]) -> float:
    return sum(40.0 * max(0.0, ROOM - gap(start, place, other)) for other in others)


def _wants(scene: Scene, regions: int, blocks: int) -> str:
    """What the scene lacks of the goal regions and blocks that a task needs at least."""
    found = len(scene.regions), len(scene.blocks)
    if found[0] >= regions and found[1] >= blocks:
        return ""
    return (
        f"expected at least {regions} goal regions and {blocks} blocks, found {found[0]} and "
        f"{found[1]}; add some"
    )


def _no_target(scene: Scene) -> str:
    if lack := _wants(scene, 1, 1):
        return lack
    colour = scene.regions[0].colour
    if any(block.colour == colour for block in scene.blocks):
        return ""
    return f"expected a {colour} block for the {colour} region, found none; add one"


def _no_duplicate(scene: Scene) -> str:
    if lack := _wants(scene, 1, 2):
        return lack
    query = scene.blocks[-1]
    if any((b.shape, b.colour) == (query.shape, query.colour) for b in scene.blocks[:-1]):
        return ""
    return f"expected a second {query.colour} {query.shape} like the query, found none; add one"


def _no_pairs(scene: Scene) -> str:
    if lack := _wants(scene, 1, 1):
        return lack
    if len(scene.blocks) == len(scene.regions):
        return ""
    return (
        f"expected one block for each goal region, found {len(scene.blocks)} blocks and "
        f"{len(scene.regions)} regions"
    )


register_goals("MoveToCorner", Goals(move_to_corner, unsolvable=lambda scene: _wants(scene, 0, 1)))
register_goals("MoveToRegion", Goals(move_to_region, unsolvable=lambda scene: _wants(scene, 1, 0)))
register_goals("MatchRegions", Goals(match_regions, unsolvable=_no_target))
register_goals("FindDupe", Goals(find_dupe, unsolvable=_no_duplicate))
register_goals("FixColour", Goals(fix_colour, unsolvable=_no_pairs))
