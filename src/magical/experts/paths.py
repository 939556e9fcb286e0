"""Ways around blocks that must not move: a straight line where it is clear, else a grid search.

The moving body is a disc; obstacles are points it should keep `clearance` away from. Closeness
costs, it does not forbid, so that a way is found from any reachable state.
"""

import math
from collections.abc import Sequence
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from magical.experts.sight import bearing, wrap
from magical.scene.geometry import Point

SPACING = 0.1  # units between grid points
HALF = 0.8  # units; a robot's centre gets no further from the middle
SIDE = round(2 * HALF / SPACING) + 1
CROWDING = 15.0  # extra cost, per unit travelled, in an obstacle's middle

TURNING = 0.3  # units that can be driven in the time of turning by one radian


def _grid() -> NDArray[np.float64]:
    ticks = np.linspace(-HALF, HALF, SIDE)
    return np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)  # (SIDE * SIDE, 2)


def _neighbours() -> list[list[tuple[int, float]]]:
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    table = []
    for cell in range(SIDE * SIDE):
        row, column = divmod(cell, SIDE)
        table.append(
            [
                ((row + i) * SIDE + column + j, SPACING * math.hypot(i, j))
                for i, j in steps
                if 0 <= row + i < SIDE and 0 <= column + j < SIDE
            ]
        )
    return table


_GRID = _grid()
_POINTS: list[Point] = [(x, y) for x, y in _GRID.tolist()]
_NEIGHBOURS = _neighbours()


def gap(start: Point, end: Point, point: Point) -> float:
    """Distance from a point to the segment between `start` and `end`."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    px, py = point[0] - start[0], point[1] - start[1]
    square = dx * dx + dy * dy
    along = 0.0 if square == 0.0 else max(0.0, min(1.0, (px * dx + py * dy) / square))
    return math.hypot(px - along * dx, py - along * dy)


def is_clear(
    start: Point,
    end: Point,
    obstacles: Sequence[Point],
    clearance: float,
    goal: Point | None = None,
) -> bool:
    """Whether the segment keeps clear of every obstacle.

    Obstacles already too close to the start only count when the segment gets closer to them, those
    too close to the goal (default: the end) when it gets closer than the goal is.
    """
    for obstacle in obstacles:
        near = gap(start, end, obstacle)
        if near >= clearance or near >= math.dist(start, obstacle) - 0.01:
            continue
        if near < _room(obstacle, goal or end, clearance):
            return False
    return True


def _room(obstacle: Point, goal: Point, clearance: float) -> float:
    return min(clearance, 0.95 * math.dist(obstacle, goal))


def next_waypoint(
    start: Point, goal: Point, obstacles: Sequence[Point], clearance: float, heading: float
) -> Point:
    """Where to head now: the goal, or the furthest point of a way around that is in clear line.

    Setting out in another direction than `heading` costs the time that the turn takes, so that
    of two equal ways the one that was taken before is kept.
    """
    if is_clear(start, goal, obstacles, clearance):
        return goal
    crowding = _crowding(obstacles, [_room(o, goal, clearance) for o in obstacles])
    way = _search(_cell(start), _cell(goal), crowding, heading)
    best = way[min(2, len(way) - 1)]
    for cell in way[3:]:
        if not is_clear(start, _POINTS[cell], obstacles, clearance - 0.02, goal):
            break
        best = cell
    return _POINTS[best]


def _cell(point: Point) -> int:
    column, row = (
        min(SIDE - 1, max(0, round((value + HALF) / SPACING))) for value in (point[0], point[1])
    )
    return row * SIDE + column


def _crowding(obstacles: Sequence[Point], rooms: Sequence[float]) -> list[float]:
    """Cost of each cell, per unit travelled."""
    offsets = _GRID[:, None] - np.array(obstacles)  # (cells, obstacles, 2)
    depth = 1.0 - np.sqrt((offsets * offsets).sum(axis=2)) / np.maximum(rooms, 0.01)
    cost: list[float] = (1.0 + CROWDING * np.maximum(depth, 0.0).sum(axis=1)).tolist()
    return cost


def _search(start: int, goal: int, cost: list[float], heading: float) -> list[int]:
    """The cheapest way over the grid (A*), both ends included."""
    gx, gy = _POINTS[goal]
    spent = {start: 0.0}
    parent: dict[int, int] = {}
    closed: set[int] = set()
    queue = [(0.0, start)]
    while queue:
        cell = heappop(queue)[1]
        if cell == goal:
            break
        if cell in closed:
            continue
        closed.add(cell)
        base, here = spent[cell], cost[cell]
        for other, length in _NEIGHBOURS[cell]:
            total = base + 0.5 * length * (here + cost[other])
            if cell == start:
                turn = bearing(_POINTS[start], _POINTS[other]) - heading
                total += TURNING * abs(wrap(turn))
            if total < spent.get(other, math.inf):
                spent[other], parent[other] = total, cell
                x, y = _POINTS[other]
                heappush(queue, (total + math.hypot(x - gx, y - gy), other))
    way = [goal]
    while way[-1] in parent and way[-1] != start:
        way.append(parent[way[-1]])
    return way[::-1]
