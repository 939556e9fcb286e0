"""Goals of the tasks with regions and of MoveToCorner, and where blocks are set down in all tasks.

Each task's function is from a state, a strategy and the last plan to the moves still to make.
"""

import math
from collections.abc import Callable, Iterable

import numpy as np

from magical.experts import geometry as g
from magical.experts.geometry import Floats
from magical.experts.planning import Move, MovePlan, Strategy
from magical.experts.state_view import StateView
from magical.scene import Colour, Point, Region, lengths, robot_polygons
from magical.scene.constants import BLOCK_SIZE, WORKSPACE_HALF
from magical.tasks.find_dupe import alike
from magical.tasks.fix_colour import mismatched
from magical.tasks.match_regions import targets
from magical.tasks.move_to_corner import GOAL

MOVE_COST = 40.0  # control steps in addition to the way, for driving up and grasping; swept
DISTANCE_COST = 1.0 / g.DRIVE_STEP  # control steps per unit of way
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

# MoveToCorner: the score is full up to 0.707 units from the corner.
CORNER_DONE = 0.64  # units from the corner that are near enough
CORNER_LIMIT = 0.82  # units: largest coordinate of a goal; tuned
CORNER_RANGE = 0.25  # units from there, in each coordinate, over which goals vary; tuned
CORNER_TOLERANCE = 0.25  # units; tuned
CORNER_TOLERANCE_RANGE = 0.25  # units added at most; tuned

# MoveToRegion, where the robot's centre must be inside.
ROBOT_DONE = 0.06  # units inside the edge: deep enough to stay inside; tuned
DEPTH = 0.09  # units inside the edge where the move ends; tuned
DEPTH_RANGE = 0.15  # units added at most; tuned
OVERSHOOT = 0.05  # units from there to the goal, so that the robot does not stop short; tuned
ROBOT_TOLERANCE = 0.06  # units; tuned
# Largest coordinate of a robot whose open fingers touch no wall at any angle, in units. Pushing
# against a wall would look like being stuck, and the robot would back out of the region.
FACING_LIMIT = WORKSPACE_HALF - max(math.hypot(*v) for part in robot_polygons() for v in part)

_SHARES = np.linspace(0.0, 1.0, PLACES_INSIDE)
_TICKS = np.linspace(-OUTER_LIMIT, OUTER_LIMIT, PLACES_OUTSIDE)
_OUTER = Region(Colour.BLUE, _TICKS[0], _TICKS[-1], *2 * [_TICKS[-1] - _TICKS[0]])


def move_to_corner(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring the block to a preferred place near the corner, with a preferred tolerance."""
    if math.dist(view.blocks[0], GOAL) < CORNER_DONE:
        return MovePlan()
    looseness, u, v = strategy.placements[:3]
    goal = CORNER_RANGE * u - CORNER_LIMIT, CORNER_LIMIT - CORNER_RANGE * v
    return MovePlan((Move(goal, CORNER_TOLERANCE + CORNER_TOLERANCE_RANGE * looseness, 0),))


def move_to_region(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Drive to a preferred point of the region."""
    region = view.scene.regions[0]
    if inset(region, ROBOT_DONE).contains(*view.position):
        return MovePlan()
    depth = DEPTH + DEPTH_RANGE * strategy.placements[2]
    preferred = preferred_point(strategy, inset(region, depth + OVERSHOOT), 0)
    x, y = (min(max(value, -FACING_LIMIT), FACING_LIMIT) for value in preferred)
    return MovePlan((Move((x, y), ROBOT_TOLERANCE, area=inset(region, depth)),))


def match_regions(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring in the blocks of the region's colour, and take the others out."""
    chosen = targets(view.scene)
    others = [i for i in range(len(view.blocks)) if i not in chosen]
    moves = moves_in(view, strategy, view.scene.regions[0], sorted(chosen))
    return MovePlan((*moves, *moves_out(view, strategy, others)))


def find_dupe(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring in a duplicate, and the query block if it has left; take other blocks out."""
    region, query = view.scene.regions[0], len(view.blocks) - 1
    duplicates = sorted(alike(view.scene) - {query})
    inside = [i for i in duplicates if region.contains(*view.blocks[i])]
    others = [i for i in range(query) if i not in duplicates]
    moves = moves_in(view, strategy, region, (query, *(inside or duplicates)))
    return MovePlan((*moves, *moves_out(view, strategy, others)))


def fix_colour(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
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


def moves_in(
    view: StateView, strategy: Strategy, region: Region, blocks: Iterable[int]
) -> list[Move]:
    """Moves that bring the `blocks` that are outside a region into it."""
    kept, done, inner = (inset(region, margin) for margin in (INSIDE, DONE_INSIDE, AIM))
    grid = _grid(inner.x + _SHARES * inner.width, inner.y - _SHARES * inner.height)
    moves = []
    for i in blocks:
        x, y = view.blocks[i]
        if not kept.contains(x, y):
            x = min(max(x, inner.x), inner.x + inner.width)
            y = min(max(y, inner.y - inner.height), inner.y)
            places = np.concatenate(([(x, y)], grid))  # (P, 2), first the nearest point
            place = _best_place(view, strategy, i, places, inner, INSIDE_PREFERENCE)
            moves.append(Move(place, TOLERANCE, i, area=done))
    return moves


def moves_out(view: StateView, strategy: Strategy, blocks: Iterable[int]) -> list[Move]:
    """Moves that take the `blocks` that are in any region out of all regions."""
    areas = [inset(region, -OUTSIDE) for region in view.scene.regions]
    inside = [i for i in blocks if any(area.contains(*view.blocks[i]) for area in areas)]
    shunned = [inset(region, -AIM) for region in view.scene.regions]

    def is_allowed(place: Point) -> bool:
        return not any(area.contains(*place) for area in shunned)

    return [Move(place_on_grid(view, strategy, i, is_allowed), TOLERANCE, i) for i in inside]


def place_on_grid(
    view: StateView, strategy: Strategy, block: int, is_allowed: Callable[[Point], bool]
) -> Point:
    """An allowed place in the workspace that is near, preferred, and clear of other blocks."""
    start, others = view.blocks[block], np.reshape(view.other_blocks(block), (-1, 2))
    places = np.array(list(filter(is_allowed, _grid(_TICKS, _TICKS).tolist())) or [start])  # (P, 2)
    _, gaps = g.project_on_segments(np.array(start), places[:, None], others)  # (P, M)
    way = WAY_COST * np.maximum(0.0, g.BLOCK_SPACING - gaps).sum(axis=1)
    return _best_place(view, strategy, block, places, _OUTER, OUTSIDE_PREFERENCE, way)


def _best_place(
    view: StateView,
    strategy: Strategy,
    block: int,
    places: Floats,
    region: Region,
    preference: float,
    way: Floats | float = 0.0,
) -> Point:
    """The cheapest of `places` (P, 2), each with the costs (P,) of the way to it."""
    others = np.reshape(view.other_blocks(block), (-1, 2))
    cost = place_costs(places, view.blocks[block], others) + way
    cost += preference * lengths(places - preferred_point(strategy, region, block))
    x, y = places[cost.argmin()].tolist()
    return x, y


def place_costs(places: Floats, block: Point, others: Floats) -> Floats:
    """Control steps (P,) to bring a block to `places` (P, 2) among `others` (M, 2)."""
    room = lengths(places[:, None] - others)  # (P, M)
    missing = np.maximum(0.0, g.BLOCK_SPACING - room).sum(axis=1)
    is_at_wall = g.excess(places, WALL_LIMIT).any(axis=1)
    costs: Floats = DISTANCE_COST * lengths(places - block) + ROOM_COST * missing
    return costs + WALL_COST * is_at_wall


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


def _grid(xs: Floats, ys: Floats) -> Floats:
    return np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
