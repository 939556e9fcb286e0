"""Shortest routes to goals, around blocks that must not be moved, from everywhere at once."""

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from magical.compiled import kernel
from magical.scene.constants import WORKSPACE_HALF

SIDE = 29  # grid points across the workspace
MOVED = 0.005  # units: routes are kept until something moves farther
OBSTRUCTED = 15.0  # extra units per unit of a route through an obstacle's centre

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

_TICKS = np.linspace(-WORKSPACE_HALF, WORKSPACE_HALF, SIDE)
_SPACING = float(_TICKS[1] - _TICKS[0])
_GRID = np.stack(np.meshgrid(_TICKS, _TICKS, indexing="ij"), axis=-1)  # (SIDE, SIDE, 2)
_CELLS = SIDE * SIDE


def _edges() -> tuple[Ints, Ints, Floats]:
    """Pairs of grid points up to a knight's move apart, sorted, and their distances."""
    moves = [(i, j) for i, j in product(range(-2, 3), repeat=2) if math.gcd(i, j) == 1]
    here = np.stack(np.divmod(np.arange(_CELLS), SIDE), axis=1)[:, None]
    there = here + np.array(moves)  # (_CELLS, 16, 2)
    start, move = np.nonzero(((there >= 0) & (there < SIDE)).all(axis=2))
    end = there[start, move] @ (SIDE, 1)
    return start, end, _SPACING * np.hypot(*np.array(moves).T)[move]


_STARTS, _ENDS, _LENGTHS = _edges()
_ROWS = np.searchsorted(_STARTS, np.arange(_CELLS + 1))  # where the edges of each point begin


class Routes:
    """The shortest routes to the nearest of some goals.

    A route through an obstacle is not forbidden but long, so there is one from everywhere.
    """

    def __init__(
        self, goals: Floats, costs: Floats, obstacles: Floats, clearance: Floats, limit: float
    ) -> None:
        """Search from goals (G, 2), whose routes cost (G,) more units.

        Routes keep a clearance (N,) from obstacles (N, 2), and coordinates within the limit.
        """
        depth = 1.0 - np.linalg.norm(_GRID[:, :, None] - obstacles, axis=-1) / clearance
        outside = (np.abs(_GRID).max(axis=-1) - limit) / _SPACING
        hindrance = depth.clip(min=0.0).sum(axis=-1) + outside.clip(min=0.0)
        weight = 1.0 + OBSTRUCTED * hindrance.ravel()
        lengths = np.append(_LENGTHS * (weight[_STARTS] + weight[_ENDS]) / 2, costs + _SPACING)
        ends = np.append(_ENDS, _nearest(goals))
        # Each goal is a point of its own, with one edge, which leads to the nearest grid point.
        numbers = np.arange(len(goals))
        rows = np.append(_ROWS, len(_ENDS) + 1 + numbers)
        graph = csr_array((lengths, ends, rows), (_CELLS + len(goals),) * 2)
        found, _, origins = dijkstra(
            graph, indices=_CELLS + numbers, return_predecessors=True, min_only=True
        )
        self._lengths = found[:_CELLS].reshape(SIDE, SIDE) - _SPACING
        self._slopes = np.stack(np.gradient(self._lengths, _SPACING), axis=-1)
        self._goals: Ints = origins[:_CELLS] - _CELLS

    def goals(self, points: Floats) -> Ints:
        """The number of the goal that the route from each point (..., 2) leads to."""
        return self._goals[_nearest(points)]

    def at(self, points: Floats) -> tuple[Floats, Floats]:
        """Lengths (...) of the routes from points (..., 2), and their directions (..., 2)."""
        where = ((points + WORKSPACE_HALF) / _SPACING).clip(0, SIDE - 1.001)
        length, direction = np.empty(points.shape[:-1]), np.empty(points.shape)
        compiled_routes(
            where.reshape(-1, 2),
            self._lengths,
            self._slopes,
            length.reshape(-1),
            direction.reshape(-1, 2),
        )
        return length, direction


class Search:
    """Finds routes, and searches again only if something has moved."""

    def __init__(self) -> None:
        self._arguments = np.empty(0)

    def __call__(
        self, goals: Floats, costs: Floats, obstacles: Floats, clearance: Floats, limit: float
    ) -> Routes:
        """The routes for these arguments; see `Routes`."""
        arguments = np.concatenate([goals.ravel(), costs, obstacles.ravel(), clearance, [limit]])
        known = self._arguments
        if len(arguments) != len(known) or np.abs(arguments - known).max() > MOVED:
            self._arguments = arguments
            self._routes = Routes(goals, costs, obstacles, clearance, limit)
        return self._routes


def _nearest(points: Floats) -> Ints:
    """The numbers of the grid points nearest to points (..., 2)."""
    at = np.rint((points + WORKSPACE_HALF) / _SPACING).astype(np.intp).clip(0, SIDE - 1)
    numbers: Ints = at[..., 0] * SIDE + at[..., 1]
    return numbers


@kernel
def compiled_routes(
    where: Floats, lengths: Floats, slopes: Floats, length: Floats, direction: Floats
) -> None:
    """Fill in lengths (P,) and directions (P, 2) of the routes from points (P, 2), in cells.

    They are interpolated from the grid's lengths (SIDE, SIDE) and their slopes (SIDE, SIDE, 2).
    """
    for at in range(len(where)):
        low_x, low_y = int(where[at, 0]), int(where[at, 1])
        part_x, part_y = where[at, 0] - low_x, where[at, 1] - low_y
        total, slope_x, slope_y = 0.0, 0.0, 0.0
        for i in range(2):
            for j in range(2):
                share = abs(1 - i - part_x) * abs(1 - j - part_y)
                total += share * lengths[low_x + i, low_y + j]
                slope_x += share * slopes[low_x + i, low_y + j, 0]
                slope_y += share * slopes[low_x + i, low_y + j, 1]
        size = max(math.sqrt(slope_x * slope_x + slope_y * slope_y), 1e-9)
        length[at], direction[at, 0], direction[at, 1] = total, -slope_x / size, -slope_y / size
