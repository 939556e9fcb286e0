"""Goals of MakeLine: all blocks on one line, evenly spread (appendix A.2.4)."""

import math
from collections.abc import Iterator, Sequence
from heapq import nsmallest
from itertools import combinations, pairwise, permutations

from magical.experts.goals import Goals, Move, Plan, Style, register_goals
from magical.experts.sight import Sight
from magical.scene.geometry import Point

SPACING = 0.29  # units between neighbours that is aimed at; up to 0.42 count
OFF_LINE = 0.14  # units from the line that are good enough; up to 0.18 count
APART = 0.40  # units between neighbours along the line that are good enough
OFF_LIMIT, APART_LIMIT = 0.178, 0.418  # units: the same once all blocks are at rest
TOLERANCE = 0.08  # units
LIMIT = 0.8  # largest coordinate of a place in the line
ANGLES = 16
MOVE_TIME = 20.0  # control steps that a move costs besides the way
LEAST = 0.26  # units between neighbours that leave room for the fingers
REFINED = 8  # lines that are looked at more closely
ROOM = 0.26  # units between blocks
TASTE = 16.0  # control steps that a demonstrator gives for the orientation it likes best


def make_line(sight: Sight, style: Style, plan: Plan) -> Plan:
    """Places for all blocks on the line that is made soonest."""
    if is_made(sight):
        return Plan()
    places = _best_places(sight.blocks, style)
    for tolerance in (TOLERANCE, 0.5 * TOLERANCE):
        if moves := _moves(sight.blocks, places, tolerance):
            return Plan(moves, places)
    return Plan()


def _moves(blocks: Sequence[Point], places: Sequence[Point], tolerance: float) -> tuple[Move, ...]:
    """Moves of the blocks that are not in their places (none where there are no places yet)."""
    return tuple(
        Move(place, tolerance, i)
        for i, (place, block) in enumerate(zip(places, blocks, strict=False))
        if math.dist(place, block) > 1.2 * tolerance
    )


def is_line(blocks: Sequence[Point], off: float = OFF_LINE, apart: float = APART) -> bool:
    """Whether all blocks are in one line, with something to spare."""
    pairs = combinations(range(len(blocks)), 2)
    return any(_fits(blocks, i, j, off, apart) for i, j in pairs)


def _fits(blocks: Sequence[Point], i: int, j: int, off: float, apart: float) -> bool:
    (x, y), length = blocks[i], math.dist(blocks[i], blocks[j]) or 1.0
    ux, uy = (blocks[j][0] - x) / length, (blocks[j][1] - y) / length
    if any(abs(ux * (b[1] - y) - uy * (b[0] - x)) > off for b in blocks):
        return False
    along = sorted(ux * (b[0] - x) + uy * (b[1] - y) for b in blocks)
    return all(b - a < apart for a, b in pairwise(along))


def _best_places(blocks: Sequence[Point], style: Style) -> tuple[Point, ...]:
    priced = ((_cost(places, blocks, style), places) for places in _candidates(blocks))
    settled = (_with_stayers(places, blocks) for _, places in nsmallest(REFINED, priced))
    return min(settled, key=lambda places: _cost(places, blocks, style))


def _with_stayers(places: tuple[Point, ...], blocks: Sequence[Point]) -> tuple[Point, ...]:
    """The same line with the blocks that fit into it as they are left where they are."""
    for i, block in enumerate(blocks):
        left = (*places[:i], block, *places[i + 1 :])
        if is_line(left, OFF_LINE - 0.03, APART - 0.02):
            places = left
    return places


def _candidates(blocks: Sequence[Point]) -> Iterator[tuple[Point, ...]]:
    """Places for all blocks on many lines."""
    yield from _through_one(blocks)
    for i, j in combinations(range(len(blocks)), 2):
        for gaps in range(1, len(blocks)):
            if LEAST < math.dist(blocks[i], blocks[j]) / gaps < APART - 0.02:
                yield from _through_two(blocks, i, j, gaps)


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
    for place, block in zip(places, blocks, strict=True):
        distance = math.dist(place, block)
        cost += MOVE_TIME + 12.0 * distance if distance > TOLERANCE else 0.0
        cost += 400.0 * max(0.0, abs(place[0]) - LIMIT, abs(place[1]) - LIMIT)
    for i, j in permutations(range(len(blocks)), 2):
        cost += 60.0 * max(0.0, ROOM - math.dist(places[i], blocks[j]))
    (x0, y0), (x1, y1) = places[0], places[-1]
    angle = math.atan2(y1 - y0, x1 - x0) % math.pi / math.pi
    return cost + TASTE * style.places[int(angle * ANGLES) % ANGLES]


def is_made(sight: Sight) -> bool:
    """Whether the blocks come to rest in one line."""
    moving = max(map(math.dist, sight.blocks, sight.resting)) > 0.005
    return is_line(sight.resting) if moving else is_line(sight.blocks, OFF_LIMIT, APART_LIMIT)


register_goals("MakeLine", Goals(make_line, is_made))
