"""Goals of MakeLine: all blocks on one line, evenly spread (appendix A.2.4)."""

import math
from collections.abc import Iterator, Sequence
from heapq import nsmallest
from itertools import combinations, pairwise, permutations

from magical.experts.goals import Goals, Move, Plan, Style, register_goals
from magical.experts.sight import Sight
from magical.scene.geometry import Point

SPACING = 0.32  # units between neighbours that is aimed at; up to 0.42 count
OFF_LINE = 0.14  # units from the line that are good enough while blocks move; up to 0.18 count
APART = 0.40  # units between neighbours along the line that are good enough while blocks move
OFF_LIMIT, APART_LIMIT = 0.178, 0.418  # units: the same once all blocks are at rest
OFF_MISS, APART_MISS = 0.05, 0.03  # units: what is kept free for a block that is still to come
TOLERANCE = 0.08  # units
HALFWAY = 0.5  # share of a block's way that its tolerance is at most
LIMIT = 0.8  # largest coordinate of a place in the line
ANGLES = 16
MOVE_TIME = 20.0  # control steps that a move costs besides the way
LEAST = 0.26  # units between neighbours that leave room for the fingers
REFINED = 24  # lines that are looked at more closely
ROOM = 0.4  # units to other blocks at which grasping and letting go are easy
TIGHT = 40.0  # control steps, per unit, that less room costs
TASTE = 30.0  # control steps that a demonstrator gives for the orientation it likes best


def make_line(sight: Sight, style: Style, plan: Plan) -> Plan:
    """Places for all blocks on the line that is made soonest."""
    if is_made(sight):
        return Plan()
    places = _best_places(sight.blocks, style, plan.places)
    return Plan(tuple(_moves(sight.blocks, places)), places)


def _moves(blocks: Sequence[Point], places: Sequence[Point]) -> Iterator[Move]:
    """Moves of the blocks that are not to stay where they are."""
    for i, (place, block) in enumerate(zip(places, blocks, strict=True)):
        if place != block:
            yield Move(place, min(TOLERANCE, HALFWAY * math.dist(place, block)), i)


def is_line(
    blocks: Sequence[Point],
    off: float = OFF_LINE,
    apart: float = APART,
    moved: Sequence[bool] | None = None,
) -> bool:
    """Whether all blocks are in one line, even if those that are `moved` there miss it a little."""
    moved = moved or [False] * len(blocks)
    pairs = combinations(range(len(blocks)), 2)
    return any(_fits(blocks, moved, i, j, off, apart) for i, j in pairs)


def _fits(
    blocks: Sequence[Point], moved: Sequence[bool], i: int, j: int, off: float, apart: float
) -> bool:
    (x, y), length = blocks[i], math.dist(blocks[i], blocks[j]) or 1.0
    ux, uy = (blocks[j][0] - x) / length, (blocks[j][1] - y) / length
    along = []
    for block, misses in zip(blocks, moved, strict=True):
        dx, dy = block[0] - x, block[1] - y
        if abs(ux * dy - uy * dx) > off - OFF_MISS * (misses or moved[i] or moved[j]):
            return False
        along.append((ux * dx + uy * dy, misses))
    along.sort()
    return all(b - a < apart - APART_MISS * (p or q) for (a, p), (b, q) in pairwise(along))


def _best_places(
    blocks: Sequence[Point], style: Style, last: tuple[Point, ...]
) -> tuple[Point, ...]:
    priced = ((_cost(places, blocks, style), places) for places in _candidates(blocks))
    lines = [places for _, places in nsmallest(REFINED, priced)]
    if len(last) == len(blocks):
        lines.append(last)
    settled = [_with_stayers(places, blocks) for places in lines]
    return min(settled, key=lambda places: _cost(places, blocks, style))


def _with_stayers(places: tuple[Point, ...], blocks: Sequence[Point]) -> tuple[Point, ...]:
    """The same line with the blocks that fit into it as they are left where they are."""
    for i in sorted(range(len(blocks)), key=lambda i: math.dist(places[i], blocks[i])):
        left = (*places[:i], blocks[i], *places[i + 1 :])
        moved = [place != block for place, block in zip(left, blocks, strict=True)]
        if _is_roomy(left, i) and is_line(left, OFF_LIMIT, APART_LIMIT, moved):
            places = left
    return places


def _is_roomy(places: Sequence[Point], i: int) -> bool:
    return all(j == i or math.dist(places[i], places[j]) > LEAST for j in range(len(places)))


def _candidates(blocks: Sequence[Point]) -> Iterator[tuple[Point, ...]]:
    """Places for all blocks on many lines."""
    yield from _longer_by_one(blocks)
    yield from _through_one(blocks)
    for i, j in combinations(range(len(blocks)), 2):
        for gaps in range(1, len(blocks)):
            if LEAST < math.dist(blocks[i], blocks[j]) / gaps < APART - 0.02:
                yield from _through_two(blocks, i, j, gaps)


def _longer_by_one(blocks: Sequence[Point]) -> Iterator[tuple[Point, ...]]:
    """Lines of all blocks but one as they are, with that one next to either end."""
    for i in range(len(blocks)):
        rest = (*blocks[:i], *blocks[i + 1 :])
        ends = max(combinations(rest, 2), key=lambda pair: math.dist(*pair), default=None)
        for (x, y), (fx, fy) in permutations(ends or (), 2):
            step = SPACING / (math.dist((x, y), (fx, fy)) or 1.0)
            places = (*blocks[:i], (x + step * (x - fx), y + step * (y - fy)), *blocks[i + 1 :])
            if is_line(places, OFF_LIMIT, APART_LIMIT, [j == i for j in range(len(blocks))]):
                yield places


def _through_one(blocks: Sequence[Point]) -> Iterator[tuple[Point, ...]]:
    """Lines through each block, in many directions, with the blocks in their order along it."""
    for angle in (math.pi * i / ANGLES for i in range(ANGLES)):
        ux, uy = math.cos(angle), math.sin(angle)
        order = sorted(range(len(blocks)), key=lambda i: ux * blocks[i][0] + uy * blocks[i][1])
        rank = {block: k for k, block in enumerate(order)}
        for anchor, (x, y) in enumerate(blocks):
            steps = [SPACING * (rank[i] - rank[anchor]) for i in range(len(blocks))]
            yield tuple((x + s * ux, y + s * uy) for s in steps)


def _through_two(blocks: Sequence[Point], i: int, j: int, gaps: int) -> Iterator[tuple[Point, ...]]:
    """Lines on which two blocks stay, `gaps` places apart, in every order of the others."""
    (x, y), dx, dy = blocks[i], blocks[j][0] - blocks[i][0], blocks[j][1] - blocks[i][1]
    others = [k for k in range(len(blocks)) if k not in (i, j)]
    for first in range(gaps + 1 - len(blocks), 1):
        free = [k for k in range(first, first + len(blocks)) if k not in (0, gaps)]
        for order in permutations(free):
            rank = {i: 0, j: gaps, **dict(zip(others, order, strict=True))}
            steps = [rank[k] / gaps for k in range(len(blocks))]
            yield tuple((x + s * dx, y + s * dy) for s in steps)


def _cost(places: Sequence[Point], blocks: Sequence[Point], style: Style) -> float:
    """Control steps, about, and what the demonstrator likes."""
    cost = 0.0
    for i, (place, block) in enumerate(zip(places, blocks, strict=True)):
        cost += 400.0 * max(0.0, abs(place[0]) - LIMIT, abs(place[1]) - LIMIT)
        if place == block:
            continue
        cost += MOVE_TIME + 12.0 * math.dist(place, block)
        for j, other in enumerate(blocks):
            if j != i:
                cost += TIGHT * max(0.0, ROOM - math.dist(block, other))
                cost += TIGHT * max(0.0, ROOM - math.dist(place, places[j]))
                cost += TIGHT * max(0.0, LEAST - math.dist(place, other))
    (x0, y0), (x1, y1) = places[0], places[-1]
    angle = math.atan2(y1 - y0, x1 - x0) % math.pi / math.pi
    return cost + TASTE * style.places[int(angle * ANGLES) % ANGLES]


def is_made(sight: Sight) -> bool:
    """Whether the blocks come to rest in one line."""
    moving = max(map(math.dist, sight.blocks, sight.resting)) > 0.005
    return is_line(sight.resting) if moving else is_line(sight.blocks, OFF_LIMIT, APART_LIMIT)


register_goals("MakeLine", Goals(make_line, is_made))
