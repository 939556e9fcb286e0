"""Moves into and out of goal regions, and the costs of moving blocks in all tasks."""

from collections.abc import Callable, Iterable

import numpy as np

from magical.experts.geometry import (
    BLOCK_SPACING,
    DRIVE_STEP,
    Floats,
    excess,
    project_on_segments,
)
from magical.experts.planning import Move, Strategy
from magical.experts.state_view import StateView
from magical.scene import Colour, Region
from magical.scene.constants import BLOCK_SIZE
from magical.scene.geometry import Point, lengths

MOVE_COST = 40.0  # control steps in addition to the way, for driving up and grasping; swept
DISTANCE_COST = 1.0 / DRIVE_STEP  # control steps per unit of way
ROOM_COST = 150.0  # control steps per unit of missing room at the goal; tuned
WALL_LIMIT = 0.85  # units: largest coordinate of a goal that costs nothing; tuned
WALL_COST = 20.0  # control steps beyond it, where fingers do not open freely; tuned

INSIDE = 0.02  # units inside the edge from which a block need not move; tuned
DONE_INSIDE = 0.04  # units inside the edge where a move ends; tuned
OUTSIDE = 0.02  # units outside the edge from which a block need not move; tuned
AIM = BLOCK_SIZE  # units inside or outside the edge to aim for; tuned
TOLERANCE = 0.08  # units; tuned
PLACES_INSIDE = 5  # per side of a region's grid of places; for time
PLACES_OUTSIDE = 15  # per side of the workspace's grid of places; for time
OUTER_LIMIT = 0.84  # units: largest coordinate of such a place; tuned
WAY_COST = 40.0  # control steps per unit of missing room to blocks on the way out; tuned
INSIDE_PREFERENCE = 6.0  # control steps per unit from the preferred place; tuned
OUTSIDE_PREFERENCE = 5.0  # the same for blocks that must leave; tuned

_SHARES = np.linspace(0.0, 1.0, PLACES_INSIDE)
_TICKS = np.linspace(-OUTER_LIMIT, OUTER_LIMIT, PLACES_OUTSIDE)
_OUTER = Region(Colour.BLUE, _TICKS[0], _TICKS[-1], *2 * [_TICKS[-1] - _TICKS[0]])


def place_costs(places: Floats, block: Point, others: Floats) -> Floats:
    """Control steps (P,) to bring a block to `places` (P, 2) and set it down there.

    Args:
        places: where the block could go.
        block: where the block is.
        others: centres (M, 2) of the other blocks, which need room next to it.
    """
    room = lengths(places[:, None] - others)  # (P, M)
    missing = np.maximum(0.0, BLOCK_SPACING - room).sum(axis=1)
    is_at_wall = excess(places, WALL_LIMIT).any(axis=1)
    costs: Floats = DISTANCE_COST * lengths(places - block) + ROOM_COST * missing
    return costs + WALL_COST * is_at_wall


def moves_in(
    view: StateView, strategy: Strategy, region: Region, blocks: Iterable[int]
) -> list[Move]:
    """Moves that bring the `blocks` that are outside a region into it."""
    kept, done = inset(region, INSIDE), inset(region, DONE_INSIDE)
    outside = [i for i in blocks if not kept.contains(*view.blocks[i])]
    return [
        Move(_place_inside(view, strategy, region, i), TOLERANCE, i, area=done) for i in outside
    ]


def moves_out(view: StateView, strategy: Strategy, blocks: Iterable[int]) -> list[Move]:
    """Moves that take the `blocks` that are in any region out of all regions."""
    areas = [inset(region, -OUTSIDE) for region in view.scene.regions]
    inside = [i for i in blocks if any(area.contains(*view.blocks[i]) for area in areas)]
    shunned = [inset(region, -AIM) for region in view.scene.regions]

    def is_allowed(place: Point) -> bool:
        return not any(area.contains(*place) for area in shunned)

    return [Move(place_on_grid(view, strategy, i, is_allowed), TOLERANCE, i) for i in inside]


def inset(region: Region, margin: float) -> Region:
    """The region shrunk by a margin on every side, but not to nothing."""
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
    """The point in a region at which the strategy prefers to have a block."""
    u, v = (strategy.placements[(2 * block + i) % len(strategy.placements)] for i in (0, 1))
    return region.x + u * region.width, region.y - v * region.height


def _place_inside(view: StateView, strategy: Strategy, region: Region, block: int) -> Point:
    """A place in a region that is near, preferred, and clear of the blocks already there."""
    inner = inset(region, AIM)
    start, others = view.blocks[block], np.reshape(view.other_blocks(block), (-1, 2))
    grid = _grid(inner.x + _SHARES * inner.width, inner.y - _SHARES * inner.height)
    places = np.concatenate(([_nearest(inner, start)], grid))  # (P, 2)
    preferred = preferred_point(strategy, inner, block)
    cost = place_costs(places, start, others)
    cost += INSIDE_PREFERENCE * lengths(places - preferred)
    return _cheapest(places, cost)


def place_on_grid(
    view: StateView, strategy: Strategy, block: int, is_allowed: Callable[[Point], bool]
) -> Point:
    """An allowed place in the workspace that is near, preferred, and clear of other blocks."""
    start, others = view.blocks[block], np.reshape(view.other_blocks(block), (-1, 2))
    places = np.array(list(filter(is_allowed, _grid(_TICKS, _TICKS).tolist())) or [start])  # (P, 2)
    preferred = preferred_point(strategy, _OUTER, block)
    _, gaps = project_on_segments(np.array(start), places[:, None], others)  # (P, M)
    cost = place_costs(places, start, others)
    cost += WAY_COST * np.maximum(0.0, BLOCK_SPACING - gaps).sum(axis=1)
    cost += OUTSIDE_PREFERENCE * lengths(places - preferred)
    return _cheapest(places, cost)


def _grid(xs: Floats, ys: Floats) -> Floats:
    return np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)


def _cheapest(places: Floats, cost: Floats) -> Point:
    x, y = places[cost.argmin()].tolist()
    return x, y


def _nearest(region: Region, point: Point) -> Point:
    """The point of a region nearest to a point."""
    x = min(max(point[0], region.x), region.x + region.width)
    y = min(max(point[1], region.y - region.height), region.y)
    return x, y
