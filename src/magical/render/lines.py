"""Smoothed lines on the ground: the workspace's edge and the regions' dashes.

A line's coverage of a sample is the overlap of its width with a box of one sample turned along the
line, times how far the sample lies within its ends (fading over one sample). The line is blended
into the sample in 8-bit steps. Coordinates are in samples, as in `polygons`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined, merged
from magical.render.canvas import Canvas, open_tile
from magical.render.polygons import Floats
from magical.scene.constants import RAW_FRAME_SIZE

# Lengths are given in pixels of the published raw frame, RAW_FRAME_SIZE across.
EDGE_WIDTH = 1.0
DASH_WIDTH = 2.5
DASH = 8  # on, and as many off
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
def clip(line: Floats, extent: float) -> bool:
    """Shorten a line (x0, y0, x1, y1) to its part within the frame; false if there is none."""
    x, y = line[0], line[1]
    dx, dy = line[2] - x, line[3] - y
    start, end = 0.0, 1.0
    for d, low, high in ((dx, -x, extent - x), (dy, -y, extent - y)):
        if d != 0.0:
            start = max(start, min(low / d, high / d))
            end = min(end, max(low / d, high / d))
        elif low > 0.0 or high < 0.0:
            return False
    if start >= end:
        return False
    line[0], line[1] = x + start * dx, y + start * dy
    line[2], line[3] = x + end * dx, y + end * dy
    return True


@merged
def stroke(canvas: Canvas, line: Floats, width: float, colour: int) -> None:
    """Blend one line (x0, y0, x1, y1) of a width in samples into the ground."""
    dx, dy = line[2] - line[0], line[3] - line[1]
    length = math.sqrt(dx * dx + dy * dy)
    if length == 0.0:
        return
    middle_x, middle_y = (line[0] + line[2]) / 2 - LINE_SHIFT, (line[1] + line[3]) / 2 - LINE_SHIFT
    side, end = width / 2 + 0.5, length / 2 + 0.5
    strip = Strip(dx / length, dy / length, middle_x, middle_y, side, end, min(width, 1.0))
    reach = abs(strip.along_x) * side + abs(strip.along_y) * end
    samples, size = canvas.samples, canvas.size
    coverage = np.empty(samples * samples, np.int32)
    bottom = _pixel(middle_y - reach, samples, size)
    for row in range(bottom, _pixel(middle_y + reach, samples, size - 1) + 1):
        left, right = _columns(strip, row * samples, samples)
        for column in range(_pixel(left, samples, size), _pixel(right, samples, size - 1) + 1):
            if _coverages(strip, column * samples, row * samples, samples, coverage):
                tile = open_tile(canvas, row * size + column)
                for i in range(samples * samples):
                    under = int(canvas.tiles[tile, i])
                    canvas.tiles[tile, i] = blend(under, colour, int(coverage[i]))


@inlined
def _columns(strip: Strip, bottom: float, samples: int) -> tuple[float, float]:
    """The x between which samples of a row of pixels may be covered."""
    reach = abs(strip.along_y) * strip.side + abs(strip.along_x) * strip.end
    if abs(strip.along_y) < LEVEL:
        return strip.middle_x - reach, strip.middle_x + reach
    lean = strip.along_x / strip.along_y
    width = strip.side / abs(strip.along_y)
    low, high = bottom - strip.middle_y, bottom + samples - strip.middle_y
    if lean < 0.0:
        low, high = high, low
    left, right = max(lean * low - width, -reach), min(lean * high + width, reach)
    return strip.middle_x + left, strip.middle_x + right


@inlined
def _coverages(
    strip: Strip, left: float, bottom: float, samples: int, coverage: NDArray[np.int32]
) -> bool:
    """The coverage of a pixel's samples in 255ths; false if all are 0. Without branches."""
    found = 0
    for i in range(samples * samples):
        x = left + (i % samples + 0.5) - strip.middle_x
        y = bottom + (i // samples + 0.5) - strip.middle_y
        across = strip.side - abs(strip.along_x * y - strip.along_y * x)
        within = strip.end - abs(strip.along_x * x + strip.along_y * y)
        part = min(max(across, 0.0), strip.most) * min(max(within, 0.0), 1.0)
        coverage[i] = np.int32(np.rint(part * 255.0))
        found |= coverage[i]
    return found != 0


@inlined
def _pixel(x: float, samples: int, most: int) -> int:
    """The pixel that x lies in, within [0, most]."""
    return min(int(max(x, 0.0)) // samples, most)


@inlined
def blend(under: int, over: int, share: int) -> int:
    """Mix two colours lane by lane: 255ths of each, rounded, are added, as in 8-bit blending."""
    return _per_255(over * share) + _per_255(under * (255 - share))


@inlined
def _per_255(products: int) -> int:
    """Each lane (at most 255 * 255) divided by 255 and rounded."""
    raised = products + 0x008000800080
    return (raised + (raised >> 8 & 0x00FF00FF00FF)) >> 8 & 0x00FF00FF00FF


@inlined
def _side(corners: Floats, i: int, extent: float, line: Floats) -> bool:
    """The i-th side of a rectangle (4, 2), clipped to the frame; false if it is out of view."""
    for k in range(2):
        line[k], line[2 + k] = corners[i, k], corners[(i + 1) % 4, k]
    return clip(line, extent)


@merged
def outline(
    canvas: Canvas, corners: Floats, colour: int, dashed: bool, counter: float, whole: bool
) -> float:
    """The workspace's edge, or a region's dashes; takes and returns the dash counter.

    Every side counts the pixels of the 384 frame from where it comes into view and advances the
    counter, so that dashes continue round corners: by a whole number, or, as in the frames of the
    human demonstrations, by its exact length. The counter is reset at an outline's first side,
    but, as in the published frames, only if that is in view.
    """
    extent = canvas.size * canvas.samples
    unit = extent / RAW_FRAME_SIZE
    width = (DASH_WIDTH if dashed else EDGE_WIDTH) * unit
    line = np.empty(4)
    for i in range(4):
        if _side(corners, i, extent, line):
            counter = 0.0 if i == 0 else counter
            base = int(counter + 1e-9)
            x, y = line[0], line[1]
            dx, dy = line[2] - x, line[3] - y
            length = math.sqrt(dx * dx + dy * dy) / unit
            count, start = round_up(length) if dashed else 1, 0
            while start < count:
                stop = min(start + DASH - (base + start) % DASH, count)
                if not dashed or (base + start) // DASH % 2 == 0:
                    if dashed:
                        a, b = start / length, min(stop / length, 1.0)
                        line[0], line[1] = x + a * dx, y + a * dy
                        line[2], line[3] = x + b * dx, y + b * dy
                    stroke(canvas, line, width, colour)
                start = stop
            counter += count if whole else length
    return counter


@inlined
def round_up(length: float) -> int:
    """A length rounded up, with a tolerance for rounding errors."""
    return math.ceil(length - 1e-9)
