"""Paths around blocks that must not be moved: straight where that is clear, else A* on a grid.

The moving body is a disc; obstacles are points that it should keep `clearance` away from. A cell
close to an obstacle costs more but is never forbidden, so that a path exists from every state.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from magical.experts.array_geometry import Floats
from magical.experts.distances import ROBOT_LIMIT
from magical.experts.motions import DRIVE_STEP, TURN_STEP
from magical.experts.state_view import bearing, wrap_angle
from magical.scene.geometry import Point


@dataclass(frozen=True, slots=True)
class PathSettings:
    """The grid, and what a path is charged for."""

    spacing: float = 0.1  # units between grid points: one control step of driving; tuned
    obstacle_cost: float = 15.0  # extra cost, per unit travelled, at an obstacle's centre; swept
    turn_cost: float = DRIVE_STEP / TURN_STEP  # units per radian of the first turn: the same time
    near_start: float = 0.01  # units: an obstacle counts if the path gets nearer by this; tuned
    near_goal: float = 0.95  # share of an obstacle's distance to the goal that is kept; tuned
    slack: float = 0.02  # units less clearance when waypoints are skipped; tuned
    first_waypoint: int = 2  # cells ahead on the path that are headed for at least; tuned


PATH = PathSettings()
SIDE = round(2 * ROBOT_LIMIT / PATH.spacing) + 1  # grid points per side


def _grid() -> Floats:
    ticks = np.linspace(-ROBOT_LIMIT, ROBOT_LIMIT, SIDE)
    return np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)  # (SIDE * SIDE, 2)


def _neighbours() -> list[list[tuple[int, float]]]:
    """For each cell the cells around it, and their distances."""
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    table = []
    for cell in range(SIDE * SIDE):
        row, column = divmod(cell, SIDE)
        table.append(
            [
                ((row + i) * SIDE + column + j, PATH.spacing * math.hypot(i, j))
                for i, j in steps
                if 0 <= row + i < SIDE and 0 <= column + j < SIDE
            ]
        )
    return table


_GRID = _grid()
_POINTS: list[Point] = [(x, y) for x, y in _GRID.tolist()]
_NEIGHBOURS = _neighbours()


def segment_distance(start: Point, end: Point, point: Point) -> float:
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

    Obstacles already too close to the start count only where the segment gets closer to them,
    those too close to the goal (default: the end) where it gets closer than the goal is.
    """
    for obstacle in obstacles:
        distance = segment_distance(start, end, obstacle)
        if distance >= clearance or distance >= math.dist(start, obstacle) - PATH.near_start:
            continue
        if distance < _kept_distance(obstacle, goal or end, clearance):
            return False
    return True


def _kept_distance(obstacle: Point, goal: Point, clearance: float) -> float:
    return min(clearance, PATH.near_goal * math.dist(obstacle, goal))


def next_waypoint(
    start: Point, goal: Point, obstacles: Sequence[Point], clearance: float, heading: float
) -> Point:
    """Where to head now: the goal, or the furthest point of a path around that is in clear line.

    Setting out in another direction than `heading` costs the time of the turn, so that of two
    equal paths the one that is being followed is kept.
    """
    if is_clear(start, goal, obstacles, clearance):
        return goal
    path = _search(_cell(start), _cell(goal), _cell_costs(obstacles, goal, clearance), heading)
    waypoint = path[min(PATH.first_waypoint, len(path) - 1)]
    for cell in path[PATH.first_waypoint + 1 :]:
        if not is_clear(start, _POINTS[cell], obstacles, clearance - PATH.slack, goal):
            break
        waypoint = cell
    return _POINTS[waypoint]


def _cell(point: Point) -> int:
    column, row = (
        min(SIDE - 1, max(0, round((value + ROBOT_LIMIT) / PATH.spacing))) for value in point
    )
    return row * SIDE + column


def _cell_costs(obstacles: Sequence[Point], goal: Point, clearance: float) -> list[float]:
    """Cost of each cell, per unit travelled."""
    kept = [max(0.01, _kept_distance(obstacle, goal, clearance)) for obstacle in obstacles]
    offsets = _GRID[:, None] - np.array(obstacles)  # (cells, obstacles, 2)
    depth = 1.0 - np.sqrt((offsets * offsets).sum(axis=2)) / kept
    cost: list[float] = (1.0 + PATH.obstacle_cost * np.maximum(depth, 0.0).sum(axis=1)).tolist()
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
                turn = bearing(_POINTS[start], _POINTS[other]) - heading
                total += PATH.turn_cost * abs(wrap_angle(turn))
            if total < spent.get(other, math.inf):
                spent[other], parent[other] = total, cell
                x, y = _POINTS[other]
                heappush(queue, (total + math.hypot(x - gx, y - gy), other))
    return _path_to(goal, start, parent)


def _path_to(goal: int, start: int, parent: dict[int, int]) -> list[int]:
    path = [goal]
    while path[-1] in parent and path[-1] != start:
        path.append(parent[path[-1]])
    return path[::-1]
