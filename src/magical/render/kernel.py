"""A frame, as one compiled function: cameras, polygons, lines, two layers and their averages.

Coordinates are in samples, x right and y up from the frame's lower left corner; `samples` x
`samples` make a pixel. Vertices are rounded to 1/256 sample, as graphics hardware does; from there
on all arithmetic is exact. A sample belongs to a polygon when its centre does; of centres on an
edge, those on left edges belong, and those at the height of a vertex go with the edge above.

The ground is painted back to front. Lines are blended with what is under them, so a ground pixel of
more than one colour keeps all its samples, in a tile. Bodies are opaque and rendered front to back:
a pixel has a mask of its uncovered samples and the sum of the others' colours, so that every sample
is written once. Colours are added in three 16-bit lanes (`palette.lanes`), in one addition.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.compiled import bit_count, inlined, kernel
from magical.render.palette import OUTSIDE, lanes
from magical.scene import FIRST_BLOCK
from magical.scene.constants import MAX_BLOCKS, RAW_FRAME_SIZE

VIEW_WIDTH = 2.04  # units: the width that both cameras show (docs/specification.md, section 6)
ROBOT_HEIGHT = 0.15  # of the frame: the robot's height above its lower edge, in the egocentric view
FURTHEST = 1e6  # units and radians: poses beyond are rejected

# Lengths of lines in pixels of the published raw frame, RAW_FRAME_SIZE across.
EDGE_WIDTH = 1.0
DASH_WIDTH = 2.5
DASH = 8  # on, then the same length off
# The allocentric frame's edges lie where coverage is exactly halfway between two 8-bit steps. The
# published frames round as if every line were shifted slightly to the left and down.
LINE_SHIFT = 1e-7  # samples
MARGIN = 1 / 64  # samples around a line in which coverage is computed

GRID = 256.0  # lines per sample that vertices lie on
MAX_SIDES = 100  # of any polygon
UNCOVERED = 48  # the lowest bit of a body pixel's mask, above its three lanes
SUMS, LANES = 0xFFFFFFFFFFFF, 0x00FF00FF00FF  # the lanes, and their low bytes
BACKGROUND = lanes(OUTSIDE)
# Rows of a polygon's array: its vertices, the first one repeated; what `scan` makes of them; and a
# rectangle's corners, not rounded and in samples, for its outline.
X, Y, ROW, BOUNDARY, SLOPE, CORNER_X, CORNER_Y = range(7)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Pixels = NDArray[np.int32]  # (P,): finished colours of three bytes


class Canvas(NamedTuple):
    """A frame's working memory, P = size * size pixels from the lowest row upwards.

    A ground pixel is a colour, or ~t for tile t; a layer opens at most one tile in a pixel.
    """

    size: int
    samples: int
    ground: Ints  # (P,)
    tiles: Ints  # (layers * P, samples * samples): the samples of mixed ground pixels
    owners: Ints  # (layers * P,): the pixel that each tile belongs to
    bodies: Ints  # (P,): mask of the uncovered samples, sum of the others' colours
    touched: Ints  # (2, size): in each row the first pixel that bodies touch, and the end
    opened: Ints  # (1,): number of tiles
    polygon: Floats  # (7, MAX_SIDES + 1)
    spans: Ints  # (2, (size + 1) * samples): in each sample row, a polygon's first sample, its end
    shares: Pixels  # (samples * samples,): of a pixel, a line's coverage in 255ths
    frames: Floats  # (5 + MAX_BLOCKS + 1, 4): bodies' on the grid, the workspace's after the last


def scratch(size: int, samples: int, layers: int) -> tuple[NDArray[Any], ...]:
    """Pixels, then the arrays of a `Canvas`; nothing is kept in them between frames."""
    blank = np.array(0xFFFF >> (16 - samples * samples), np.uint64) << np.uint64(UNCOVERED)
    return (
        np.empty(size * size, np.int32),
        np.empty(size * size, np.int64),
        np.empty((layers * size * size, samples * samples), np.int64),
        np.empty(layers * size * size, np.int64),
        np.full(size * size, blank).view(np.int64),
        np.repeat([[size], [0]], size, axis=1),
        np.zeros(1, np.int64),
        np.empty((7, MAX_SIDES + 1)),
        np.empty((2, (size + 1) * samples), np.int64),
        np.empty(samples * samples, np.int32),
        np.empty((FIRST_BLOCK + MAX_BLOCKS + 1, 4)),
    )


@inlined
def pack(colour: int) -> int:
    """A colour of three 16-bit lanes as three bytes, red lowest."""
    return colour & 0xFF | colour >> 8 & 0xFF00 | colour >> 16 & 0xFF0000


@inlined
def mean(total: int, count: int) -> int:
    """The mean of 1, 4 or 16 colours, halves rounded to even, as three bytes."""
    if count == 1:
        return pack(total)
    shift = 2 if count == 4 else 4
    odd = total >> shift & 0x000100010001
    return pack((total + 0x000100010001 * (count // 2 - 1) + odd) >> shift & LANES)


@inlined
def rint(x: float) -> float:
    """The nearest integer, halves to even, of a number below 2**51."""
    return (x + 6755399441055744.0) - 6755399441055744.0


@inlined
def blend(under: int, over: int, share: int) -> int:
    """Mix two colours lane by lane: 255ths of each, rounded, are added, as in 8-bit blending."""
    first, second = over * share + 0x008000800080, under * (255 - share) + 0x008000800080
    first, second = first + (first >> 8 & LANES), second + (second >> 8 & LANES)
    return (first >> 8 & LANES) + (second >> 8 & LANES)


@inlined
def scan(polygon: Floats, sides: int, extent: int, samples: int, spans: Ints) -> tuple[int, int]:
    """Write a convex polygon's spans; returns the rows of pixels [low, high) that it touches.

    A row's boundary is the first sample whose centre is at or right of the edge:
    ceil((x - 128) / 256) for the edge's x, a fraction whose denominator is the edge's height dy.
    Half a unit of its numerator is subtracted before rounding down and adding 1, so that rounding
    errors change nothing. The first loops have no branches: several edges are computed at once.
    """
    half, furthest = GRID / 2, float(extent)
    polygon[X, sides], polygon[Y, sides] = polygon[X, 0], polygon[Y, 0]
    for i in range(sides + 1):  # the first row whose centre is at or above a vertex
        polygon[ROW, i] = min(max(rint((polygon[Y, i] - 0.5) / GRID), 0.0), furthest)
    for i in range(sides):
        rises = polygon[Y, i] < polygon[Y, i + 1]
        x = polygon[X, i] if rises else polygon[X, i + 1]
        y = polygon[Y, i] if rises else polygon[Y, i + 1]
        dx = polygon[X, i + 1] - polygon[X, i] if rises else polygon[X, i] - polygon[X, i + 1]
        dy = abs(polygon[Y, i + 1] - polygon[Y, i])
        per_dy = 1.0 / max(dy, 1.0)
        bottom = GRID * min(polygon[ROW, i], polygon[ROW, i + 1]) + half
        polygon[SLOPE, i] = dx * per_dy
        across = (x - half) * dy + (bottom - y) * dx - 0.5
        polygon[BOUNDARY, i] = across * per_dy / GRID + 1.0
    low = high = int(polygon[ROW, 0])
    for i in range(sides):
        start, stop = int(polygon[ROW, i]), int(polygon[ROW, i + 1])
        low, high = min(low, stop), max(high, stop)
        side, first = (1, start) if start < stop else (0, stop)
        boundary, slope = polygon[BOUNDARY, i], polygon[SLOPE, i]
        for j in range(abs(stop - start)):
            spans[side, first + j] = int(min(max(boundary + j * slope, 0.0), furthest))
    bottom_pixel, top_pixel = low // samples, (high + samples - 1) // samples
    for row in range(bottom_pixel * samples, low):  # empty: the rest of the first row of pixels
        spans[0, row], spans[1, row] = extent, 0
    for row in range(high, top_pixel * samples):  # and of the last
        spans[0, row], spans[1, row] = extent, 0
    return bottom_pixel, top_pixel


@inlined
def pixel_spans(spans: Ints, row: int, samples: int) -> tuple[int, int, int, int]:
    """Where a row of pixels is touched, covered, no longer covered, no longer touched.

    `row` is the lowest of its sample rows. If nothing is covered, the middle two are the last.
    """
    first_left = last_left = spans[0, row]
    first_right = last_right = spans[1, row]
    for k in range(1, samples):
        left, right = spans[0, row + k], spans[1, row + k]
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
        left = min(max(spans[0, row + k] - x * samples, 0), samples)
        right = min(max(spans[1, row + k] - x * samples, 0), samples)
        bits |= (((1 << right) - 1) & -(1 << left)) << (k * samples)
    return bits


@inlined
def open_tile(canvas: Canvas, pixel: int) -> int:
    """The index of the ground pixel's tile; a new one, filled with its colour, if it has none."""
    entry: int = canvas.ground[pixel]
    if entry < 0:
        return ~entry
    tile: int = canvas.opened[0]
    canvas.opened[0] = tile + 1
    canvas.owners[tile] = pixel
    canvas.ground[pixel] = ~tile
    for i in range(canvas.samples * canvas.samples):
        canvas.tiles[tile, i] = entry
    return tile


@inlined
def paint(canvas: Canvas, pixel: int, bits: int, colour: int) -> None:
    """Paint samples of a ground pixel over what is there."""
    if bits:
        tile = open_tile(canvas, pixel)
        for i in range(canvas.samples * canvas.samples):
            under = canvas.tiles[tile, i]
            canvas.tiles[tile, i] = colour if bits >> i & 1 else under


@inlined
def cover(canvas: Canvas, pixel: int, bits: int, colour: int) -> None:
    """Cover samples of a pixel with a body, without a branch, which could not be predicted."""
    entry = canvas.bodies[pixel]
    new = bits & (entry >> UNCOVERED)
    canvas.bodies[pixel] = (entry ^ (new << UNCOVERED)) + bit_count(new) * colour


@inlined
def fill(canvas: Canvas, sides: int, colour: int, body: bool) -> None:
    """Fill the canvas's polygon: of a body, behind those already there, or over the ground."""
    samples, size, spans = canvas.samples, canvas.size, canvas.spans
    full = 0xFFFF >> (16 - samples * samples)
    low, high = scan(canvas.polygon, sides, size * samples, samples, spans)
    for y in range(low, high):
        touched, covered, uncovered, end = pixel_spans(spans, y * samples, samples)
        if body:
            canvas.touched[0, y] = min(canvas.touched[0, y], touched)
            canvas.touched[1, y] = max(canvas.touched[1, y], end)
        for x in range(y * size + covered, y * size + uncovered):
            if body:
                cover(canvas, x, full, colour)
            else:
                canvas.ground[x] = colour
        for first, last in ((touched, covered), (uncovered, end)):
            for x in range(first, last):
                bits = mask(spans, y * samples, samples, x)
                if body:
                    cover(canvas, y * size + x, bits, colour)
                else:
                    paint(canvas, y * size + x, bits, colour)


@inlined
def stroke(
    canvas: Canvas, ends: tuple[float, float, float, float], width: float, colour: int
) -> None:
    """Blend a line (x0, y0, x1, y1) of a width in samples into the ground.

    Its coverage of a sample is the overlap of its width with a box of one sample turned along the
    line, times how far the sample lies within its ends (fading over one sample), in 8-bit steps.
    """
    samples, size, polygon = canvas.samples, canvas.size, canvas.polygon
    x0, y0, x1, y1 = ends
    length = math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
    if length == 0.0:
        return
    along_x, along_y = (x1 - x0) / length, (y1 - y0) / length
    middle_x, middle_y = (x0 + x1) / 2 - LINE_SHIFT, (y0 + y1) / 2 - LINE_SHIFT
    # The distance from the line, and from its middle along it, where coverage becomes 0.
    side, end = width / 2 + 0.5, length / 2 + 0.5
    for k in range(4):  # the rectangle within which it is more
        ahead = end + MARGIN if k == 1 or k == 2 else -end - MARGIN
        left = side + MARGIN if k >= 2 else -side - MARGIN
        polygon[X, k] = rint(GRID * (middle_x + ahead * along_x - left * along_y))
        polygon[Y, k] = rint(GRID * (middle_y + ahead * along_y + left * along_x))
    low, high = scan(polygon, 4, size * samples, samples, canvas.spans)
    for row in range(low, high):
        first, _, _, last = pixel_spans(canvas.spans, row * samples, samples)
        for column in range(first, last):
            tile = open_tile(canvas, row * size + column)
            for i in range(samples * samples):
                x = column * samples + (i % samples + 0.5) - middle_x
                y = row * samples + (i // samples + 0.5) - middle_y
                across = min(max(side - abs(along_x * y - along_y * x), 0.0), min(width, 1.0))
                within = min(max(end - abs(along_x * x + along_y * y), 0.0), 1.0)
                canvas.shares[i] = np.int32(rint(across * within * 255.0))
            for i in range(samples * samples):
                share: Any = np.int64(canvas.shares[i])
                canvas.tiles[tile, i] = blend(canvas.tiles[tile, i], colour, share)


@inlined
def clip(x: float, y: float, dx: float, dy: float, extent: float) -> tuple[float, float]:
    """The fractions of a line from (x, y) between which it is in the frame; 1, 0 if nowhere."""
    start, end = 0.0, 1.0
    for d, low, high in ((dx, -x, extent - x), (dy, -y, extent - y)):
        if d != 0.0:
            start = max(start, min(low / d, high / d))
            end = min(end, max(low / d, high / d))
        elif low > 0.0 or high < 0.0:
            return 1.0, 0.0
    return start, end


@inlined
def outline(canvas: Canvas, colour: int, dashed: bool, counter: float, whole: bool) -> float:
    """Stroke the workspace's edge, or a region's dashes; takes and returns the dash counter.

    Every side counts the pixels of the 384 frame from where it comes into view and advances the
    counter, so that dashes continue around corners: with `whole` by a whole number, otherwise by
    its exact length, as in the frames of the human demonstrations. The counter is reset at an
    outline's first side, but only if that is in view, as in the published frames.
    """
    extent = float(canvas.size * canvas.samples)
    unit = extent / RAW_FRAME_SIZE
    width, corners = (DASH_WIDTH if dashed else EDGE_WIDTH) * unit, canvas.polygon
    for i in range(4):
        x, y = corners[CORNER_X, i], corners[CORNER_Y, i]
        dx, dy = corners[CORNER_X, (i + 1) % 4] - x, corners[CORNER_Y, (i + 1) % 4] - y
        first, last = clip(x, y, dx, dy, extent)
        if first < last:
            counter = 0.0 if i == 0 else counter
            x0, y0 = x + first * dx, y + first * dy
            dx, dy = x + last * dx - x0, y + last * dy - y0
            length = math.sqrt(dx * dx + dy * dy) / unit
            count = math.ceil(length - 1e-9)  # a tolerance for rounding errors
            base, on = (int(counter + 1e-9), DASH) if dashed else (0, max(count, 1))
            for dash in range(base // (2 * on), (base + count) // (2 * on) + 1):
                start = max(2 * on * dash - base, 0)
                stop = min(2 * on * dash + on - base, count)
                if start < stop:
                    a, b = start / length, min(stop / length, 1.0)
                    ends = x0 + a * dx, y0 + a * dy, x0 + b * dx, y0 + b * dy
                    stroke(canvas, ends, width, colour)
            counter += count if whole else length
    return counter


@inlined
def camera(bodies: Floats, ego: bool, extent: float, frames: Floats) -> None:
    """Compute each body's frame on the grid, the workspace's last: scaled cos and sin, x, y."""
    scale, count = GRID * extent / VIEW_WIDTH, len(bodies)
    x, y, turn, height = 0.0, 0.0, 0.0, 0.5  # the camera's pose, and its height in the frame
    if ego:
        x, y, turn, height = bodies[0, 0], bodies[0, 1], bodies[0, 2], ROBOT_HEIGHT
    centre_x, centre_y = GRID * extent / 2, GRID * extent * height
    cos, sin = scale * math.cos(-turn), scale * math.sin(-turn)
    for i in range(count):
        dx, dy = bodies[i, 0] - x, bodies[i, 1] - y
        frames[i, 0] = scale * math.cos(bodies[i, 2] - turn)
        frames[i, 1] = scale * math.sin(bodies[i, 2] - turn)
        frames[i, 2] = cos * dx - sin * dy + centre_x
        frames[i, 3] = sin * dx + cos * dy + centre_y
    frames[count, 0], frames[count, 1] = cos, sin
    frames[count, 2] = centre_x - (cos * x - sin * y)
    frames[count, 3] = centre_y - (sin * x + cos * y)


@inlined
def draw_ground(
    canvas: Canvas, areas: Floats, colours: Ints, frame: Floats, ego: bool, whole: bool
) -> None:
    """Paint the background, the workspace and its edge, the regions and their dashes."""
    for pixel in range(canvas.size * canvas.size):
        canvas.ground[pixel] = BACKGROUND
    polygon, counter, canvas.opened[0] = canvas.polygon, 0.0, 0
    if ego:
        # The published environments render an allocentric frame before every egocentric one; this
        # is the dash counter that its last outline, entirely in view, leaves.
        last, pixel_width = areas[len(areas) - 1], VIEW_WIDTH / RAW_FRAME_SIZE
        width, height = last[1, 0] - last[0, 0], last[0, 1] - last[3, 1]
        counter = 2.0 * (width + height) / pixel_width
        if whole:
            width, height = width / pixel_width - 1e-9, height / pixel_width - 1e-9
            counter = 2.0 * (math.ceil(width) + math.ceil(height))
    for i in range(len(areas)):
        for k in range(4):
            x = frame[0] * areas[i, k, 0] - frame[1] * areas[i, k, 1] + frame[2]
            y = frame[1] * areas[i, k, 0] + frame[0] * areas[i, k, 1] + frame[3]
            polygon[CORNER_X, k], polygon[CORNER_Y, k] = x / GRID, y / GRID
            polygon[X, 3 - k], polygon[Y, 3 - k] = rint(x), rint(y)
        fill(canvas, 4, colours[i, 0], False)
        advanced = outline(canvas, colours[i, 1], i > 0, counter, whole)
        counter = advanced if i > 0 else counter


@inlined
def draw_bodies(canvas: Canvas, vertices: Floats, items: Ints, offsets: Floats) -> None:
    """Draw blocks and robot, front to back (see `display.DisplayList` for the arrays)."""
    polygon, frames = canvas.polygon, canvas.frames
    for i in range(len(items)):
        first, sides, anchor, turn = items[i, 0], items[i, 1], items[i, 2], items[i, 3]
        x, y = offsets[i, 0], offsets[i, 1]
        x0 = frames[anchor, 0] * x - frames[anchor, 1] * y + frames[anchor, 2]
        y0 = frames[anchor, 1] * x + frames[anchor, 0] * y + frames[anchor, 3]
        cos, sin = frames[turn, 0], frames[turn, 1]
        for k in range(sides):
            x, y = vertices[0, first + k], vertices[1, first + k]
            polygon[X, k] = rint(cos * x - sin * y + x0)
            polygon[Y, k] = rint(sin * x + cos * y + y0)
        fill(canvas, sides, items[i, 4], True)


@inlined
def composite(canvas: Canvas, pixels: Pixels) -> None:
    """Put the bodies over the finished ground in `pixels`, and clear them for the next frame."""
    samples, size = canvas.samples * canvas.samples, canvas.size
    full = 0xFFFF >> (16 - samples)
    for y in range(size):
        for pixel in range(y * size + canvas.touched[0, y], y * size + canvas.touched[1, y]):
            entry = canvas.bodies[pixel]
            if entry != full << UNCOVERED:
                canvas.bodies[pixel] = full << UNCOVERED
                total, bits = entry & SUMS, (entry >> UNCOVERED) & full
                under = canvas.ground[pixel]
                if bits and under >= 0:
                    total += bit_count(bits) * under
                elif bits:
                    for i in range(samples):
                        total += canvas.tiles[~under, i] if bits >> i & 1 else 0
                pixels[pixel] = mean(total, samples)
        canvas.touched[0, y], canvas.touched[1, y] = size, 0


@cache
def frame_kernel(samples: int) -> Callable[..., int]:
    """The compiled renderer for samples x samples samples in a pixel (1, 2 or 4 across)."""

    @kernel
    def draw(
        size: int, ego: bool, fresh: bool, whole: bool, kept: Pixels, pixels: Pixels,
        bodies: Floats, vertices: Floats, items: Ints, offsets: Floats, areas: Floats,
        colours: Ints, *memory: Any,
    ) -> int:  # fmt: skip
        """Draw a frame into `pixels`; returns the number of the ground's tiles, -1 for far poses.

        The ground, finished in `kept`, is drawn if `fresh`, and else still there. In the egocentric
        view it always is, and `kept` may be `pixels`. `whole` is for `outline`. `bodies` (n, 3 or
        more) are poses in the rows of `Poses`; then come the arrays of `display.DisplayList` and
        those of `Canvas`.
        """
        for i in range(len(bodies)):
            for k in range(3):
                if not abs(bodies[i, k]) <= FURTHEST:  # also true for NaN
                    return -1
        canvas = Canvas(size, samples, *memory)
        camera(bodies, ego, float(size * samples), canvas.frames)
        if fresh:
            draw_ground(canvas, areas, colours, canvas.frames[len(bodies)], ego, whole)
            for pixel in range(len(pixels)):
                kept[pixel] = pack(canvas.ground[pixel])
            for tile in range(canvas.opened[0]):
                if canvas.ground[canvas.owners[tile]] == ~tile:  # nothing was painted over it
                    total = 0
                    for i in range(samples * samples):
                        total += canvas.tiles[tile, i]
                    kept[canvas.owners[tile]] = mean(total, samples * samples)
        if not ego:
            for pixel in range(len(pixels)):
                pixels[pixel] = kept[pixel]
        draw_bodies(canvas, vertices, items, offsets)
        composite(canvas, pixels)
        count: int = canvas.opened[0]
        return count

    return draw


@kernel
def write(pixels: Pixels, out: NDArray[np.uint8]) -> None:
    """Write pixels, lowest row first, into `out` (size, size, 3) of any layout, highest first."""
    size = out.shape[0]
    for y in range(size):
        for x in range(size):
            colour = pixels[(size - 1 - y) * size + x]
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = colour, colour >> 8, colour >> 16


@kernel
def push(pixels: Pixels, stack: NDArray[np.uint32]) -> None:
    """Drop the oldest of a stack's four frames and add the newest, in one pass.

    The stack is given as little-endian words, three for a pixel: (size, 3 * size).
    """
    size = stack.shape[0]
    for y in range(size):
        newest, row = pixels[(size - 1 - y) * size :], stack[y]
        for x in range(size):
            a, b, c = row[3 * x], row[3 * x + 1], row[3 * x + 2]
            row[3 * x] = a >> 24 | b << 8
            row[3 * x + 1] = b >> 24 | c << 8
            row[3 * x + 2] = c >> 24 | np.uint32(newest[x]) << 8
