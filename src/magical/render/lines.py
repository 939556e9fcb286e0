"""Smoothed lines on the ground: the workspace's edge and the regions' dashes.

A line's coverage of a sample is the overlap of its width with a box of one sample turned along the
line, times how far the sample lies within its ends (fading over one sample). The line is blended
into the sample in 8-bit steps. Coordinates are in samples, as in `polygons`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import inlined, integer, maximum, merged, minimum, rint
from magical.render.canvas import Canvas, open_tile
from magical.render.polygons import CORNER_X, CORNER_Y
from magical.scene.constants import RAW_FRAME_SIZE

# Lengths are given in pixels of the published raw frame, RAW_FRAME_SIZE across.
EDGE_WIDTH = 1.0
DASH_WIDTH = 2.5
DASH = 8  # on, then the same length off
# The allocentric frame's edges lie where coverage is exactly halfway between two 8-bit steps. The
# published frames round as if every line were shifted slightly to the left and down.
LINE_SHIFT = 1e-7  # samples
LEVEL = 1e-9  # a line that rises less than this per unit of length is treated as level


class Strip(NamedTuple):
    """The rectangle of samples that a line covers, at least in part."""

    along_x: float  # the line's direction
    along_y: float
    middle_x: float
    middle_y: float
    side: float  # distance from the line, and from its middle along it, where coverage becomes 0
    end: float
    most: float  # coverage of a sample in the middle


@inlined
def clip(x: float, y: float, dx: float, dy: float, extent: float) -> tuple[float, float]:
    """The fractions of a line from (x, y) between which it is in the frame; 1, 0 if nowhere."""
    start, end = 0.0, 1.0
    for d, low, high in ((dx, -x, extent - x), (dy, -y, extent - y)):
        if d != 0.0:
            start = maximum(start, minimum(low / d, high / d))
            end = minimum(end, maximum(low / d, high / d))
        elif low > 0.0 or high < 0.0:
            return 1.0, 0.0
    return start, end


@merged
def stroke(
    canvas: Canvas, ends: tuple[float, float, float, float], width: float, colour: int
) -> None:
    """Blend one line (x0, y0, x1, y1) of a width in samples into the ground."""
    x0, y0, x1, y1 = ends
    dx, dy = x1 - x0, y1 - y0
    length = math.sqrt(dx * dx + dy * dy)
    if length == 0.0:
        return
    middle_x, middle_y = (x0 + x1) / 2 - LINE_SHIFT, (y0 + y1) / 2 - LINE_SHIFT
    side, end = width / 2 + 0.5, length / 2 + 0.5
    strip = Strip(dx / length, dy / length, middle_x, middle_y, side, end, minimum(width, 1.0))
    reach = abs(strip.along_x) * side + abs(strip.along_y) * end
    samples, size = canvas.samples, canvas.size
    coverage = canvas.coverage
    bottom = _pixel(middle_y - reach, samples, size)
    for row in range(bottom, _pixel(middle_y + reach, samples, size - 1) + 1):
        left, right = _columns(strip, row * samples, samples)
        for column in range(_pixel(left, samples, size), _pixel(right, samples, size - 1) + 1):
            if _coverages(strip, column * samples, row * samples, samples, coverage):
                tile = open_tile(canvas, row * size + column)
                for i in range(samples * samples):
                    under = integer(canvas.tiles[tile, i])
                    canvas.tiles[tile, i] = blend(under, colour, integer(coverage[i]))


@inlined
def _columns(strip: Strip, bottom: float, samples: int) -> tuple[float, float]:
    """The range of x in which samples of a row of pixels may be covered."""
    reach = abs(strip.along_y) * strip.side + abs(strip.along_x) * strip.end
    if abs(strip.along_y) < LEVEL:
        return strip.middle_x - reach, strip.middle_x + reach
    lean = strip.along_x / strip.along_y
    width = strip.side / abs(strip.along_y)
    low, high = bottom - strip.middle_y, bottom + samples - strip.middle_y
    if lean < 0.0:
        low, high = high, low
    left, right = maximum(lean * low - width, -reach), minimum(lean * high + width, reach)
    return strip.middle_x + left, strip.middle_x + right


@inlined
def _coverages(
    strip: Strip, left: float, bottom: float, samples: int, coverage: NDArray[np.int32]
) -> bool:
    """Compute, without branches, the coverage of a pixel's samples in 255ths; false if all 0."""
    found = 0
    for i in range(samples * samples):
        x = left + (i % samples + 0.5) - strip.middle_x
        y = bottom + (i // samples + 0.5) - strip.middle_y
        across = strip.side - abs(strip.along_x * y - strip.along_y * x)
        within = strip.end - abs(strip.along_x * x + strip.along_y * y)
        part = minimum(maximum(across, 0.0), strip.most) * minimum(maximum(within, 0.0), 1.0)
        coverage[i] = np.int32(rint(part * 255.0))
        found |= coverage[i]
    return found != 0


@inlined
def _pixel(x: float, samples: int, most: int) -> int:
    """The pixel that x lies in, within [0, most]."""
    pixel: int = minimum(integer(maximum(x, 0.0)) // samples, most)
    return pixel


@inlined
def blend(under: int, over: int, share: int) -> int:
    """Mix two colours lane by lane: 255ths of each, rounded, are added, as in 8-bit blending."""
    return _per_255(over * share) + _per_255(under * (255 - share))


@inlined
def _per_255(products: int) -> int:
    """Each lane (at most 255 * 255) divided by 255 and rounded."""
    raised = products + 0x008000800080
    return (raised + (raised >> 8 & 0x00FF00FF00FF)) >> 8 & 0x00FF00FF00FF


@merged
def outline(canvas: Canvas, colour: int, dashed: bool, counter: float, whole: bool) -> float:
    """Stroke the workspace's edge, or a region's dashes; takes and returns the dash counter.

    Every side counts the pixels of the 384 frame from where it comes into view and advances the
    counter, so that dashes continue around corners: with `whole` by a whole number, otherwise by
    its exact length, as in the frames of the human demonstrations. The counter is reset at an
    outline's first side, but only if that is in view, as in the published frames.
    """
    extent = canvas.size * canvas.samples
    unit = extent / RAW_FRAME_SIZE
    width = (DASH_WIDTH if dashed else EDGE_WIDTH) * unit
    corners = canvas.polygon
    for i in range(4):
        x, y = corners[CORNER_X, i], corners[CORNER_Y, i]
        dx, dy = corners[CORNER_X, (i + 1) % 4] - x, corners[CORNER_Y, (i + 1) % 4] - y
        first, last = clip(x, y, dx, dy, extent)
        if first < last:
            counter = 0.0 if i == 0 else counter
            base = integer(counter + 1e-9)
            x1, y1 = x + last * dx, y + last * dy
            x0, y0 = x + first * dx, y + first * dy
            dx, dy = x1 - x0, y1 - y0
            length = math.sqrt(dx * dx + dy * dy) / unit
            count, start = round_up(length) if dashed else 1, 0
            while start < count:
                stop = minimum(start + DASH - (base + start) % DASH, count)
                if not dashed or (base + start) // DASH % 2 == 0:
                    ends = x0, y0, x1, y1
                    if dashed:
                        a, b = start / length, minimum(stop / length, 1.0)
                        ends = x0 + a * dx, y0 + a * dy, x0 + b * dx, y0 + b * dy
                    stroke(canvas, ends, width, colour)
                start = stop
            counter += count if whole else length
    return counter


@inlined
def round_up(length: float) -> int:
    """A length rounded up, with a tolerance for rounding errors."""
    return math.ceil(length - 1e-9)
