"""Moves into and out of goal regions."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from magical.experts.distances import ROBOT_LIMIT
from magical.experts.paths import segment_distance
from magical.experts.planning import Move, Strategy
from magical.experts.state_view import StateView, is_within
from magical.scene import Colour, Region, Scene
from magical.scene.geometry import Point


@dataclass(frozen=True, slots=True)
class RegionSettings:
    """Where blocks count as inside or outside, and where they are brought."""

    inside: float = 0.02  # units inside the edge from which a block need not move; tuned
    done: float = 0.04  # units inside the edge where a move ends; tuned
    outside: float = 0.02  # units outside the edge from which a block need not move; tuned
    margin: float = 0.12  # units inside or outside the edge that are aimed at: a block's radius
    tolerance: float = 0.08  # units; tuned
    grid: float = 0.12  # units between places outside that are tried; for time
    grid_limit: float = 0.84  # units: largest coordinate of these; tuned
    shares: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a region's sides that are tried


@dataclass(frozen=True, slots=True)
class PlaceSettings:
    """What a place for a block is charged for, in control steps."""

    distance: float = 10.0  # per unit from the block: a control step drives 0.1
    room: float = 0.27  # units between the centres of blocks side by side; tuned
    block: float = 150.0  # per unit of missing room to another block; tuned
    way: float = 40.0  # per unit of missing room to another block on the way; tuned
    wall: float = 4.0  # at a wall, where fingers do not open freely; tuned
    preference_inside: float = 6.0  # per unit from the preferred place; tuned
    preference_outside: float = 5.0  # the same for blocks that must leave; tuned


REGION = RegionSettings()
PLACE = PlaceSettings()

_TICKS = tuple(
    -REGION.grid_limit + REGION.grid * i
    for i in range(round(2 * REGION.grid_limit / REGION.grid) + 1)
)
_WORKSPACE = Region(Colour.BLUE, _TICKS[0], _TICKS[-1], *2 * (_TICKS[-1] - _TICKS[0],))


def moves_in(
    view: StateView, strategy: Strategy, region: Region, blocks: Collection[int]
) -> list[Move]:
    """Moves that bring those of `blocks` that are outside into a region."""
    kept, done = inset(region, REGION.inside), inset(region, REGION.done)
    outside = [i for i in blocks if not kept.contains(*view.blocks[i])]
    places = [_place_inside(view, strategy, region, i) for i in outside]
    return [
        Move(place, REGION.tolerance, i, area=done)
        for i, place in zip(outside, places, strict=True)
    ]


def moves_out(
    view: StateView, strategy: Strategy, region: Region, allowed: Collection[int]
) -> list[Move]:
    """Moves that take blocks out of a region, all but those that are `allowed` there."""
    area = inset(region, -REGION.outside)
    others = [i for i in range(len(view.blocks)) if i not in allowed]
    return [_move_out(view, strategy, i) for i in others if area.contains(*view.blocks[i])]


def moves_out_of_all(view: StateView, strategy: Strategy, blocks: Collection[int]) -> list[Move]:
    """Moves that take those of `blocks` that are in any region out of all."""
    areas = [inset(region, -REGION.outside) for region in view.scene.regions]
    inside = [i for i in blocks if any(area.contains(*view.blocks[i]) for area in areas)]
    return [_move_out(view, strategy, i) for i in inside]


def inset(region: Region, margin: float) -> Region:
    """The region made smaller by a margin on every side, but not to nothing."""
    across = min(margin, region.width / 2 - 0.01)
    down = min(margin, region.height / 2 - 0.01)
    return Region(
        region.colour,
        region.x + across,
        region.y - down,
        region.height - 2 * down,
        region.width - 2 * across,
    )


def preferred_point(strategy: Strategy, region: Region, block: int) -> Point:
    """Where in a region the strategy prefers to have a block."""
    u, v = (strategy.placements[(2 * block + i) % len(strategy.placements)] for i in (0, 1))
    return region.x + u * region.width, region.y - v * region.height


def missing_parts(scene: Scene, regions: int, blocks: int) -> str:
    """What a scene lacks of the goal regions and blocks that a task needs, or an empty text."""
    found = len(scene.regions), len(scene.blocks)
    if found[0] >= regions and found[1] >= blocks:
        return ""
    return (
        f"expected at least {regions} goal regions and {blocks} blocks, found {found[0]} and "
        f"{found[1]}; add some"
    )


def _move_out(view: StateView, strategy: Strategy, block: int) -> Move:
    return Move(_place_outside(view, strategy, block), REGION.tolerance, block)


def _place_inside(view: StateView, strategy: Strategy, region: Region, block: int) -> Point:
    """A place in a region that is near, preferred, and clear of the blocks already there."""
    inner = inset(region, REGION.margin)
    start, others = view.blocks[block], view.other_blocks(block)
    preferred = preferred_point(strategy, inner, block)
    places = [_nearest(inner, start)]
    places += [
        (inner.x + u * inner.width, inner.y - v * inner.height)
        for u in REGION.shares
        for v in REGION.shares
    ]

    def cost(place: Point) -> float:
        preference = PLACE.preference_inside * math.dist(place, preferred)
        return _place_cost(place, start, others) + preference

    return min(places, key=cost)


def _place_outside(view: StateView, strategy: Strategy, block: int) -> Point:
    """A place outside all regions that is near, preferred, and clear of other blocks."""
    areas = [inset(region, -REGION.margin) for region in view.scene.regions]
    start, others = view.blocks[block], view.other_blocks(block)
    preferred = preferred_point(strategy, _WORKSPACE, block)
    places = [
        (x, y) for x in _TICKS for y in _TICKS if not any(area.contains(x, y) for area in areas)
    ]

    def cost(place: Point) -> float:
        preference = PLACE.preference_outside * math.dist(place, preferred)
        return _place_cost(place, start, others) + _way_cost(place, start, others) + preference

    return min(places or [start], key=cost)


def _nearest(region: Region, point: Point) -> Point:
    """The point of a region nearest to a point."""
    x = min(max(point[0], region.x), region.x + region.width)
    y = min(max(point[1], region.y - region.height), region.y)
    return x, y


def _place_cost(place: Point, start: Point, others: Sequence[Point]) -> float:
    """Control steps to bring a block there, and what walls and blocks there add to them."""
    cost = PLACE.distance * math.dist(place, start)
    cost += 0.0 if is_within(place, ROBOT_LIMIT) else PLACE.wall
    for other in others:
        cost += PLACE.block * max(0.0, PLACE.room - math.dist(place, other))
    return cost


def _way_cost(place: Point, start: Point, others: Sequence[Point]) -> float:
    gaps = (segment_distance(start, place, other) for other in others)
    return sum(PLACE.way * max(0.0, PLACE.room - gap) for gap in gaps)
