"""Paths around blocks that must not be moved: straight if that is clear, else A* on a grid.

The moving body is a disc; obstacles are points that it should keep `clearance` away from. A cell
close to an obstacle costs more but is never forbidden, so that a path exists from every state.
"""

import math
from collections.abc import Sequence
from heapq import heappop, heappush
from itertools import product

import numpy as np

from magical.experts import geometry as g
from magical.experts.geometry import Floats
from magical.scene import Point, lengths

SPACING = 0.1  # units between grid points: one control step of driving; tuned
OBSTACLE_COST = 15.0  # extra cost, per unit travelled, at an obstacle's centre; swept
TURN_COST = g.DRIVE_STEP / g.TURN_STEP  # units that take as long as a radian of the first turn
NEAR_START = 0.01  # units: an obstacle counts only if the path gets nearer by this; tuned
NEAR_GOAL = 0.95  # share of an obstacle's distance to the goal that is kept; tuned
SLACK = 0.02  # units less clearance when waypoints are skipped; tuned
FIRST_WAYPOINT = 2  # cells: the least distance along the path to head for; tuned

SIDE = round(2 * g.ROBOT_LIMIT / SPACING) + 1  # grid points per side
_TICKS = np.linspace(-g.ROBOT_LIMIT, g.ROBOT_LIMIT, SIDE)
_GRID: Floats = np.stack(np.meshgrid(_TICKS, _TICKS), axis=-1).reshape(-1, 2)  # (SIDE * SIDE, 2)
_POINTS: list[Point] = [(x, y) for x, y in _GRID.tolist()]


def _neighbours(cell: int) -> list[tuple[int, float]]:
    """The cells around a cell, and their distances."""
    row, column = divmod(cell, SIDE)
    return [
        ((row + i) * SIDE + column + j, SPACING * math.hypot(i, j))
        for i, j in product((-1, 0, 1), repeat=2)
        if (i or j) and 0 <= row + i < SIDE and 0 <= column + j < SIDE
    ]


_NEIGHBOURS = [_neighbours(cell) for cell in range(SIDE * SIDE)]


def is_clear(
    start: Point,
    end: Point,
    obstacles: Sequence[Point],
    clearance: float,
    goal: Point | None = None,
) -> bool:
    """Whether the segment keeps clear of every obstacle.

    Obstacles already too close to the start count only if the segment gets closer to them, and
    those too close to the goal (default: the end) only if it gets closer than the goal is.
    """
    for obstacle in obstacles:
        distance = g.segment_distance(start, end, obstacle)
        if distance >= clearance or distance >= math.dist(start, obstacle) - NEAR_START:
            continue
        if distance < _kept_distance(obstacle, goal or end, clearance):
            return False
    return True


def _kept_distance(obstacle: Point, goal: Point, clearance: float) -> float:
    return min(clearance, NEAR_GOAL * math.dist(obstacle, goal))


def next_waypoint(
    start: Point, goal: Point, obstacles: Sequence[Point], clearance: float, heading: float
) -> Point:
    """The point to head for: the goal, or the furthest path point with a clear straight line to it.

    Starting in a direction other than `heading` costs the time of the turn, so that of two equal
    paths, the one that is being followed is kept.
    """
    if is_clear(start, goal, obstacles, clearance):
        return goal
    path = _search(_cell(start), _cell(goal), _cell_costs(obstacles, goal, clearance), heading)
    waypoint = path[min(FIRST_WAYPOINT, len(path) - 1)]
    for cell in path[FIRST_WAYPOINT + 1 :]:
        if not is_clear(start, _POINTS[cell], obstacles, clearance - SLACK, goal):
            break
        waypoint = cell
    return _POINTS[waypoint]


def _cell(point: Point) -> int:
    column, row = (
        min(SIDE - 1, max(0, round((value + g.ROBOT_LIMIT) / SPACING))) for value in point
    )
    return row * SIDE + column


def _cell_costs(obstacles: Sequence[Point], goal: Point, clearance: float) -> list[float]:
    """Cost of each cell, per unit travelled."""
    kept = [max(0.01, _kept_distance(obstacle, goal, clearance)) for obstacle in obstacles]
    depth = 1.0 - lengths(_GRID[:, None] - np.array(obstacles)) / kept  # (cells, obstacles)
    cost: list[float] = (1.0 + OBSTACLE_COST * np.maximum(depth, 0.0).sum(axis=1)).tolist()
    return cost


def _search(start: int, goal: int, cost: list[float], heading: float) -> list[int]:
    """The cheapest path over the grid (A*), both ends included."""
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
        for other, length in _NEIGHBOURS[cell]:
            total = spent[cell] + 0.5 * length * (cost[cell] + cost[other])
            if cell == start:
                turn = g.bearing(_POINTS[start], _POINTS[other]) - heading
                total += TURN_COST * abs(g.wrap_angle(turn))
            if total < spent.get(other, math.inf):
                spent[other], parent[other] = total, cell
                x, y = _POINTS[other]
                heappush(queue, (total + math.hypot(x - gx, y - gy), other))
    path = [goal]
    while path[-1] != start:
        path.append(parent[path[-1]])
    return path[::-1]
