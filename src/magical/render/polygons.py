"""Exact scan conversion of convex polygons to spans of samples.

Coordinates are in samples, x right and y up from the frame's lower left corner. Vertices are
rounded to 1/256 sample, as graphics hardware does; from there on all arithmetic is exact. A sample
belongs to a polygon when its centre does; of centres on an edge, those on left edges belong, and
those at the height of a vertex go with the edge above.
"""

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import ceil, inlined, integer, maximum, merged, minimum, rint

SUBSAMPLES = 256.0  # vertices lie on a grid of this many lines per sample
LEFT, RIGHT = 0, 1  # rows of `spans`
MAX_SIDES = 100  # of any polygon
# Rows of `polygon`: its vertices, the first one repeated; what `scan` computes from them; and a
# rectangle's corners, not rounded and in samples, for its outline.
X, Y, ROW, BOUNDARY, SLOPE, CORNER_X, CORNER_Y = range(7)
POLYGON_ROWS = 7

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@inlined
def place(
    vertices: Floats,
    first: int,
    count: int,
    cos: float,
    sin: float,
    x0: float,
    y0: float,
    polygon: Floats,
) -> None:
    """Transform vertices to the grid, into `polygon`.

    The body's angle is given as cos and sin (times the scale), its position in grid lines.
    """
    for i in range(count):
        x, y = vertices[0, first + i], vertices[1, first + i]
        polygon[X, i] = rint(cos * x - sin * y + x0)
        polygon[Y, i] = rint(sin * x + cos * y + y0)
    polygon[X, count] = polygon[X, 0]
    polygon[Y, count] = polygon[Y, 0]


@merged
def scan(polygon: Floats, count: int, extent: int, spans: Ints) -> tuple[int, int]:
    """Write each sample row's span [left, right) to `spans` (2, rows); returns rows [low, high).

    A row's boundary is the first sample whose centre is at or right of the edge:
    ceil((x - 128) / 256) for the edge's x, a fraction whose denominator is the edge's height dy.
    Half a unit of its numerator is subtracted before rounding down and adding 1: the result is the
    same, and rounding errors of the floating-point arithmetic cannot change it.
    """
    _prepare(polygon, count, float(extent))
    low = high = polygon[ROW, 0]
    for i in range(count):
        start, stop = polygon[ROW, i], polygon[ROW, i + 1]
        low, high = minimum(low, stop), maximum(high, stop)
        if start != stop:
            side = RIGHT if start < stop else LEFT
            row = integer(minimum(start, stop))
            boundary, slope = polygon[BOUNDARY, i], polygon[SLOPE, i]
            for j in range(integer(abs(stop - start))):
                spans[side, row + j] = integer(minimum(maximum(boundary + j * slope, 0.0), extent))
    return integer(low), integer(high)


@inlined
def _prepare(polygon: Floats, count: int, height: float) -> None:
    """For each vertex, the first row above it; for each edge, its lowest row's boundary, its slope.

    Separate from `scan`'s loop and without branches, so that several edges are computed at once.
    """
    half = SUBSAMPLES / 2
    for i in range(count + 1):
        polygon[ROW, i] = minimum(maximum(ceil((polygon[Y, i] - half) / SUBSAMPLES), 0.0), height)
    for i in range(count):
        rises = polygon[Y, i] < polygon[Y, i + 1]
        x = polygon[X, i] if rises else polygon[X, i + 1]
        y = polygon[Y, i] if rises else polygon[Y, i + 1]
        dx = polygon[X, i + 1] - polygon[X, i] if rises else polygon[X, i] - polygon[X, i + 1]
        dy = abs(polygon[Y, i + 1] - polygon[Y, i])
        per_dy = 1.0 / maximum(dy, 1.0)
        bottom = SUBSAMPLES * minimum(polygon[ROW, i], polygon[ROW, i + 1]) + half
        polygon[SLOPE, i] = dx * per_dy
        across = (x - half) * dy + (bottom - y) * dx - 0.5
        polygon[BOUNDARY, i] = across * per_dy / SUBSAMPLES + 1.0


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

    `row` is the lowest of its sample rows. Nothing is covered if the second is not below the
    third.
    """
    first_left = last_left = spans[LEFT, row]
    first_right = last_right = spans[RIGHT, row]
    for k in range(1, samples):
        left, right = spans[LEFT, row + k], spans[RIGHT, row + k]
        first_left, last_left = minimum(first_left, left), maximum(last_left, left)
        first_right, last_right = minimum(first_right, right), maximum(last_right, right)
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
        left = minimum(maximum(spans[LEFT, row + k] - x * samples, 0), samples)
        right = minimum(maximum(spans[RIGHT, row + k] - x * samples, 0), samples)
        bits |= (((1 << right) - 1) & -(1 << left)) << (k * samples)
    return bits
