"""Goals of MakeLine: all blocks in one line, evenly spread (appendix A.2.4).

Many lines are proposed: through each block in many directions, through two blocks that stay, and
extensions of lines that all blocks but one already form. The cheapest are improved by leaving
blocks that fit where they are, and the cheapest of the results is made.
"""

import math
from collections.abc import Iterator, Sequence
from heapq import nsmallest
from itertools import combinations, pairwise, permutations
from typing import NamedTuple

from magical.experts.geometry import BLOCK_SPACING, ROBOT_LIMIT, WORKING_DISTANCE
from magical.experts.goals.regions import DISTANCE_COST, MOVE_COST
from magical.experts.planning import Move, MovePlan, Strategy
from magical.experts.state_view import StateView
from magical.scene import Point
from magical.tasks.scoring import INLIER_DISTANCE, NEIGHBOUR_DISTANCE

Places = tuple[Point, ...]  # one for each block


class LineLimits(NamedTuple):
    """How exactly blocks must be in line: the score's limits less a margin, in units."""

    off_line: float  # from the line
    spacing: float  # between neighbours along it


MOVING = LineLimits(INLIER_DISTANCE - 0.04, NEIGHBOUR_DISTANCE - 0.02)  # tuned
RESTING = LineLimits(INLIER_DISTANCE - 0.002, NEIGHBOUR_DISTANCE - 0.002)  # tuned
MOVED_SLACK = LineLimits(0.05, 0.03)  # subtracted next to a block that is yet to come; tuned
SPACING = 0.32  # units between neighbours to aim for; tuned
DIRECTIONS = 16  # of lines through one block; for time
IMPROVED = 24  # proposals that are improved; for time
TOLERANCE = 0.08  # units; tuned
TOLERANCE_SHARE = 0.5  # of a block's way: upper limit of its tolerance; tuned
STILL = 0.005  # units left to move, up to which blocks count as resting

# Costs of a line in addition to its moves, in control steps.
WALL_COST = 400.0  # per unit that a place is outside `ROBOT_LIMIT`; tuned
ROOM_COST = 40.0  # per unit of missing room to other blocks; tuned
PREFERENCE = 30.0  # between the most and the least preferred direction; tuned


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Move all blocks to their places on the line that is quickest to make."""
    return plan_line(view, range(len(view.blocks)), strategy, last)


def is_solved(view: StateView) -> bool:
    """Whether all blocks come to rest in one line."""
    return is_line_made(view.blocks, view.resting_blocks)


def plan_line(
    view: StateView, chosen: Sequence[int], strategy: Strategy, last: MovePlan
) -> MovePlan:
    """As `plan`, for the chosen blocks only; short moves have a smaller tolerance."""
    blocks, resting = [view.blocks[i] for i in chosen], [view.resting_blocks[i] for i in chosen]
    if is_line_made(blocks, resting):
        return MovePlan()
    places = _best_places(blocks, strategy, last.places)
    moves = [
        Move(place, min(TOLERANCE, TOLERANCE_SHARE * math.dist(place, block)), i)
        for i, place, block in zip(chosen, places, blocks, strict=True)
        if place != block
    ]
    return MovePlan(tuple(moves), places)


def is_line_made(blocks: Sequence[Point], resting: Sequence[Point]) -> bool:
    """Whether blocks, and where they come to rest, are in one line."""
    if max(map(math.dist, blocks, resting)) > STILL:
        return is_line(resting, MOVING)
    return is_line(blocks, RESTING)


def is_line(
    blocks: Sequence[Point], limits: LineLimits = MOVING, moved: Sequence[bool] | None = None
) -> bool:
    """Whether all blocks are in line, even if those that are `moved` there miss it slightly."""
    moved = moved or [False] * len(blocks)
    pairs = combinations(range(len(blocks)), 2)
    return any(_is_line_through(i, j, blocks, limits, moved) for i, j in pairs)


def _is_line_through(
    i: int, j: int, blocks: Sequence[Point], limits: LineLimits, moved: Sequence[bool]
) -> bool:
    """Whether all blocks are in line with blocks i and j."""
    (x, y), length = blocks[i], math.dist(blocks[i], blocks[j]) or 1.0
    ux, uy = (blocks[j][0] - x) / length, (blocks[j][1] - y) / length
    along = []
    for block, misses in zip(blocks, moved, strict=True):
        dx, dy = block[0] - x, block[1] - y
        slack = MOVED_SLACK.off_line * (misses or moved[i] or moved[j])
        if abs(ux * dy - uy * dx) > limits.off_line - slack:
            return False
        along.append((ux * dx + uy * dy, misses))
    along.sort()
    return all(
        b - a < limits.spacing - MOVED_SLACK.spacing * (p or q)
        for (a, p), (b, q) in pairwise(along)
    )


def _best_places(blocks: Sequence[Point], strategy: Strategy, last: Places) -> Places:
    """The cheapest line; the last one is included, so that plans do not change needlessly."""
    priced = ((_cost(places, blocks, strategy), places) for places in _proposals(blocks))
    lines = [places for _, places in nsmallest(IMPROVED, priced)]
    if len(last) == len(blocks):
        lines.append(last)
    improved = [_with_stayers(places, blocks) for places in lines]
    return min(improved, key=lambda places: _cost(places, blocks, strategy))


def _with_stayers(places: Places, blocks: Sequence[Point]) -> Places:
    """The same line, with the blocks that already fit into it left where they are."""
    for i in sorted(range(len(blocks)), key=lambda i: math.dist(places[i], blocks[i])):
        others = (*places[:i], *places[i + 1 :])
        stayed = (*places[:i], blocks[i], *places[i + 1 :])
        moved = [place != block for place, block in zip(stayed, blocks, strict=True)]
        has_room = all(math.dist(blocks[i], other) > BLOCK_SPACING for other in others)
        if has_room and is_line(stayed, RESTING, moved):
            places = stayed
    return places


def _proposals(blocks: Sequence[Point]) -> Iterator[Places]:
    """Places for all blocks on many lines."""
    yield from _longer_by_one(blocks)
    yield from _through_one(blocks)
    for i, j in combinations(range(len(blocks)), 2):
        for gaps in range(1, len(blocks)):
            spacing = math.dist(blocks[i], blocks[j]) / gaps
            if BLOCK_SPACING < spacing < MOVING.spacing - 0.02:
                yield from _through_two(blocks, i, j, gaps)


def _longer_by_one(blocks: Sequence[Point]) -> Iterator[Places]:
    """Lines that all blocks but one already form, with that one next to either end."""
    for i in range(len(blocks)):
        rest = (*blocks[:i], *blocks[i + 1 :])
        ends = max(combinations(rest, 2), key=lambda pair: math.dist(*pair), default=None)
        for (x, y), (fx, fy) in permutations(ends or (), 2):
            step = SPACING / (math.dist((x, y), (fx, fy)) or 1.0)
            places = (*blocks[:i], (x + step * (x - fx), y + step * (y - fy)), *blocks[i + 1 :])
            if is_line(places, RESTING, [j == i for j in range(len(blocks))]):
                yield places


def _through_one(blocks: Sequence[Point]) -> Iterator[Places]:
    """Lines through each block, in many directions, with the blocks in their order along it."""
    for angle in (math.pi * i / DIRECTIONS for i in range(DIRECTIONS)):
        ux, uy = math.cos(angle), math.sin(angle)
        order = sorted(range(len(blocks)), key=lambda i: ux * blocks[i][0] + uy * blocks[i][1])
        rank = {block: k for k, block in enumerate(order)}
        for stays, (x, y) in enumerate(blocks):
            steps = [SPACING * (rank[i] - rank[stays]) for i in range(len(blocks))]
            yield tuple((x + s * ux, y + s * uy) for s in steps)


def _through_two(blocks: Sequence[Point], i: int, j: int, gaps: int) -> Iterator[Places]:
    """Lines on which two blocks stay, `gaps` places apart, in every order of the others."""
    (x, y), dx, dy = blocks[i], blocks[j][0] - blocks[i][0], blocks[j][1] - blocks[i][1]
    others = [k for k in range(len(blocks)) if k not in (i, j)]
    for first in range(gaps + 1 - len(blocks), 1):
        free = [k for k in range(first, first + len(blocks)) if k not in (0, gaps)]
        for order in permutations(free):
            rank = {i: 0, j: gaps, **dict(zip(others, order, strict=True))}
            steps = [rank[k] / gaps for k in range(len(blocks))]
            yield tuple((x + s * dx, y + s * dy) for s in steps)


def _cost(places: Places, blocks: Sequence[Point], strategy: Strategy) -> float:
    """Approximate control steps that a line takes, plus the cost of its direction."""
    (x0, y0), (x1, y1) = places[0], places[-1]
    half_turns = math.atan2(y1 - y0, x1 - x0) % math.pi / math.pi
    cost = PREFERENCE * strategy.placements[int(half_turns * DIRECTIONS) % DIRECTIONS]
    for i, (place, block) in enumerate(zip(places, blocks, strict=True)):
        cost += WALL_COST * max(0.0, abs(place[0]) - ROBOT_LIMIT, abs(place[1]) - ROBOT_LIMIT)
        if place != block:
            cost += MOVE_COST + DISTANCE_COST * math.dist(place, block)
            cost += ROOM_COST * _missing_room(i, places, blocks)
    return cost


def _missing_room(i: int, places: Places, blocks: Sequence[Point]) -> float:
    """Units of room to other blocks that block i lacks where it is grasped and released."""
    missing = 0.0
    for j, other in enumerate(blocks):
        if j != i:
            missing += max(0.0, WORKING_DISTANCE - math.dist(blocks[i], other))
            missing += max(0.0, WORKING_DISTANCE - math.dist(places[i], places[j]))
            missing += max(0.0, BLOCK_SPACING - math.dist(places[i], other))
    return missing
