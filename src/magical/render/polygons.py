"""Exact scan conversion of convex polygons to spans of samples.

Coordinates are in samples, x right and y up from the frame's lower left corner. Vertices are
rounded to 1/256 sample, as graphics hardware does; from there on all arithmetic is exact. A sample
belongs to a polygon when its centre does; of centres on an edge, those on left edges belong, and
those at the height of a vertex go with the edge above.
"""

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined, merged

SUBSAMPLES = 256.0  # vertices lie on a grid of this many lines a sample
LEFT, RIGHT = 0, 1  # rows of `spans`
MAX_SIDES = 100  # of any polygon
ROW, BOUNDARY, SLOPE = 0, 1, 2  # rows of `edges`

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@inlined
def place(vertices: Floats, first: int, count: int, frame: Floats, placed: Floats) -> None:
    """Transform a polygon's vertices to the grid: `placed` (2, more than count), first repeated.

    `frame` holds cos and sin (times the scale) of the body's angle and its position, in grid lines.
    """
    cos, sin, x0, y0 = frame[0], frame[1], frame[2], frame[3]
    for i in range(count):
        x, y = vertices[0, first + i], vertices[1, first + i]
        placed[0, i] = np.rint(cos * x - sin * y + x0)
        placed[1, i] = np.rint(sin * x + cos * y + y0)
    placed[0, count] = placed[0, 0]
    placed[1, count] = placed[1, 0]


@merged
def scan(
    placed: Floats, count: int, width: int, height: int, edges: Floats, spans: Ints
) -> tuple[int, int]:
    """Each sample row's span [left, right) into `spans` (2, rows); returns the rows [low, high).

    A row's boundary is the first sample whose centre is at or right of the edge:
    ceil((x - 128) / 256) for the edge's x, a fraction whose denominator is the edge's height dy.
    Half a unit of its numerator is taken off before rounding down and adding 1: the result is the
    same, and rounding errors of the floating-point arithmetic cannot change it.
    """
    _prepare(placed, count, float(height), edges)
    low = high = edges[ROW, 0]
    for i in range(count):
        start, stop = edges[ROW, i], edges[ROW, i + 1]
        low, high = min(low, stop), max(high, stop)
        if start != stop:
            side = RIGHT if start < stop else LEFT
            row, boundary, slope = int(min(start, stop)), edges[BOUNDARY, i], edges[SLOPE, i]
            for j in range(int(abs(stop - start))):
                spans[side, row + j] = int(min(max(boundary + j * slope, 0.0), width))
    return int(low), int(high)


@inlined
def _prepare(placed: Floats, count: int, height: float, edges: Floats) -> None:
    """For each vertex the first row above it; for each edge its lowest row's boundary, its slope.

    Apart from `scan`'s loop and without branches, so that several edges are computed at once.
    """
    half = SUBSAMPLES / 2
    for i in range(count + 1):
        edges[ROW, i] = min(max(np.ceil((placed[1, i] - half) / SUBSAMPLES), 0.0), height)
    for i in range(count):
        rises = placed[1, i] < placed[1, i + 1]
        x = placed[0, i] if rises else placed[0, i + 1]
        y = placed[1, i] if rises else placed[1, i + 1]
        dx = placed[0, i + 1] - placed[0, i] if rises else placed[0, i] - placed[0, i + 1]
        dy = abs(placed[1, i + 1] - placed[1, i])
        per_dy = 1.0 / max(dy, 1.0)
        bottom = SUBSAMPLES * min(edges[ROW, i], edges[ROW, i + 1]) + half
        edges[SLOPE, i] = dx * per_dy
        across = (x - half) * dy + (bottom - y) * dx - 0.5
        edges[BOUNDARY, i] = across * per_dy / SUBSAMPLES + 1.0


@inlined
def pad(spans: Ints, low: int, high: int, samples: int, width: int) -> None:
    """Set empty spans in the rows that complete the first and the last row of pixels."""
    for row in range(low // samples * samples, low):
        spans[LEFT, row], spans[RIGHT, row] = width, 0
    for row in range(high, (high + samples - 1) // samples * samples):
        spans[LEFT, row], spans[RIGHT, row] = width, 0


@inlined
def pixel_spans(spans: Ints, row: int, samples: int) -> tuple[int, int, int, int]:
    """Where a row of pixels is touched, covered, no longer covered, no longer touched.

    `row` is the lowest of its sample rows. Nothing is covered when the second is not below the
    third.
    """
    first_left = last_left = spans[LEFT, row]
    first_right = last_right = spans[RIGHT, row]
    for k in range(1, samples):
        left, right = spans[LEFT, row + k], spans[RIGHT, row + k]
        first_left, last_left = min(first_left, left), max(last_left, left)
        first_right, last_right = min(first_right, right), max(last_right, right)
    touched, end = first_left // samples, (last_right + samples - 1) // samples
    covered, uncovered = (last_left + samples - 1) // samples, first_right // samples
    if covered >= uncovered:
        return touched, end, end, end
    return touched, covered, uncovered, end


@inlined
def mask(spans: Ints, row: int, samples: int, x: int) -> int:
    """Which samples of pixel x are covered: bit k * samples + i for column i of sample row k."""
    bits = 0
    for k in range(samples):
        left = min(max(spans[LEFT, row + k] - x * samples, 0), samples)
        right = min(max(spans[RIGHT, row + k] - x * samples, 0), samples)
        bits |= (((1 << right) - 1) & -(1 << left)) << (k * samples)
    return bits
