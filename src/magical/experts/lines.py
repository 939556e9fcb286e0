"""Goals of MakeLine: all blocks on one line, evenly spread (appendix A.2.4)."""

import math
from collections.abc import Iterator, Sequence
from itertools import combinations, permutations

from magical.experts.goals import Goals, Move, Plan, Style, register_goals
from magical.experts.sight import Sight
from magical.scene.geometry import Point

SPACING = 0.33  # units between neighbours that is aimed at; up to 0.42 count
OFF_LINE = 0.14  # units from the line that are good enough; up to 0.18 count
APART = 0.40  # units between neighbours along the line that are good enough
TOLERANCE = 0.06  # units
LIMIT = 0.8  # largest coordinate of a place in the line
ANGLES = 16
MOVE_TIME = 20.0  # control steps that a move costs besides the way
ROOM = 0.26  # units between blocks
TASTE = 16.0  # control steps that a demonstrator gives for the orientation it likes best


def make_line(sight: Sight, style: Style, plan: Plan) -> Plan:
    """Places for all blocks on the line that is made soonest."""
    if is_made(sight):
        return Plan()
    places = plan.places or _best_places(sight.blocks, style)
    moves = tuple(
        Move(place, TOLERANCE, i)
        for i, (place, block) in enumerate(zip(places, sight.blocks, strict=True))
        if math.dist(place, block) > 1.3 * TOLERANCE
    )
    return Plan(moves, places) if moves else make_line(sight, style, Plan()) if plan.places else Plan()


def is_line(blocks: Sequence[Point]) -> bool:
    """Whether all blocks are in one line, with something to spare."""
    return any(_fits(blocks, i, j) for i, j in combinations(range(len(blocks)), 2))


def _fits(blocks: Sequence[Point], i: int, j: int) -> bool:
    (x, y), length = blocks[i], math.dist(blocks[i], blocks[j])
    ux, uy = (blocks[j][0] - x) / length, (blocks[j][1] - y) / length
    if any(abs(ux * (b[1] - y) - uy * (b[0] - x)) > OFF_LINE for b in blocks):
        return False
    along = sorted(ux * (b[0] - x) + uy * (b[1] - y) for b in blocks)
    return all(b - a < APART for a, b in zip(along, along[1:], strict=False))


def _best_places(blocks: Sequence[Point], style: Style) -> tuple[Point, ...]:
    return min(_candidates(blocks), key=lambda places: _cost(places, blocks, style))


def _candidates(blocks: Sequence[Point]) -> Iterator[tuple[Point, ...]]:
    """Places on lines through each block, in many directions, in the blocks' order along it."""
    angles = [math.pi * i / ANGLES for i in range(ANGLES)]
    angles += [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in combinations(blocks, 2)]
    for angle in angles:
        ux, uy = math.cos(angle), math.sin(angle)
        order = sorted(range(len(blocks)), key=lambda i: ux * blocks[i][0] + uy * blocks[i][1])
        rank = {block: k for k, block in enumerate(order)}
        for anchor, (x, y) in enumerate(blocks):
            steps = [SPACING * (rank[i] - rank[anchor]) for i in range(len(blocks))]
            yield tuple((x + s * ux, y + s * uy) for s in steps)


def _cost(places: Sequence[Point], blocks: Sequence[Point], style: Style) -> float:
    """Control steps, about, and what the demonstrator likes."""
    cost = 0.0
    for place, block in zip(places, blocks, strict=True):
        distance = math.dist(place, block)
        cost += MOVE_TIME + 12.0 * distance if distance > TOLERANCE else 0.0
        cost += 400.0 * max(0.0, abs(place[0]) - LIMIT, abs(place[1]) - LIMIT)
    for place, other in permutations(zip(places, blocks, strict=True), 2):
        cost += 60.0 * max(0.0, ROOM - math.dist(place[0], other[1]))
    (x0, y0), (x1, y1) = places[0], places[-1]
    angle = math.atan2(y1 - y0, x1 - x0) % math.pi / math.pi
    return cost + TASTE * style.places[int(angle * ANGLES) % ANGLES]


def is_made(sight: Sight) -> bool:
    """Whether the blocks come to rest in one line."""
    return is_line(sight.resting)


register_goals("MakeLine", Goals(make_line, is_made))
