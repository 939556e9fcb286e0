"""The two layers of a frame: the ground, painted back to front, and the bodies in front of it.

The ground (workspace, regions, lines) keeps every sample's colour, as lines are blended with what
is under them, but only in pixels with more than one colour: these have a tile. The bodies are
opaque and rendered front to back: a pixel holds a mask of the samples that are still uncovered and
the sum of the others' colours, so that every sample is written once. Colours are added in 16-bit
lanes (see `palette.lanes`), three channels in one addition.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import count_bits, inlined, integer, maximum, merged, minimum
from magical.render.polygons import MAX_SIDES, POLYGON_ROWS, Floats, Ints, mask, pad, pixel_spans

UNCOVERED = 48  # the lowest bit of a body pixel's mask; below it are the three lanes
EVERY_SAMPLE = 0xFFFF  # sixteen bits of mask
SUMS = 0xFFFFFFFFFFFF  # the three lanes
LANES = 0x00FF00FF00FF  # their low bytes


class Canvas(NamedTuple):
    """A frame's pixels, from the lowest row upwards, P = size * size of them.

    A ground pixel is a colour (red in the lowest byte), or ~t for tile t. Every layer of the
    ground opens at most one tile in a pixel. `pixels` starts as the ground and becomes the frame;
    if the ground is not reused, both are the same array.
    """

    size: int
    samples: int
    ground: NDArray[np.int32]  # (P,)
    pixels: NDArray[np.int32]  # (P,)
    tiles: Ints  # (layers * P, samples * samples): the samples of mixed ground pixels, as lanes
    owners: NDArray[np.int32]  # (layers * P,): the pixel that each tile belongs to
    counts: Ints  # (1,): number of tiles
    bodies: Ints  # (P,): mask of the uncovered samples, sum of the others' colours
    touched: Ints  # (2, size): in each row the first pixel that bodies touch, and the end
    polygon: Floats  # (POLYGON_ROWS, MAX_SIDES + 1): see `polygons`
    spans: Ints  # (2, (size + 1) * samples): of a polygon's sample rows
    coverage: NDArray[np.int32]  # (samples * samples,): of a pixel, by a line


def working_memory(size: int, samples: int, layers: int) -> tuple[NDArray[Any], ...]:
    """The arrays of a `Canvas` from `tiles` to `coverage`, which keep nothing between calls."""
    count, per_pixel = size * size, samples * samples
    # A body pixel without any covered sample; 64 bits, signed.
    blank = ((1 << per_pixel) - 1) << UNCOVERED if samples < 4 else -1 << UNCOVERED
    return (
        np.empty((layers * count, per_pixel), np.int64),
        np.empty(layers * count, np.int32),
        np.empty(1, np.int64),
        np.full(count, blank, np.int64),
        np.repeat([[size], [0]], size, axis=1),
        np.empty((POLYGON_ROWS, MAX_SIDES + 1)),
        np.empty((2, (size + 1) * samples), np.int64),
        np.empty(per_pixel, np.int32),
    )


@inlined
def pack(colour: int) -> int:
    """A colour of three 16-bit lanes as three bytes."""
    return colour & 0xFF | colour >> 8 & 0xFF00 | colour >> 16 & 0xFF0000


@inlined
def unpack(colour: int) -> int:
    """A colour of three bytes as three 16-bit lanes."""
    return colour & 0xFF | (colour & 0xFF00) << 8 | (colour & 0xFF0000) << 16


@inlined
def mean(total: int, count: int) -> int:
    """The mean of 1, 4 or 16 colours, halves rounded to even, lane by lane."""
    if count == 1:
        return total
    shift = 2 if count == 4 else 4
    odd = total >> shift & 0x000100010001
    return (total + 0x000100010001 * (count // 2 - 1) + odd) >> shift & LANES


@inlined
def open_tile(canvas: Canvas, pixel: int) -> int:
    """The index of the ground pixel's tile; a new one, filled with its colour, if it has none."""
    entry = integer(canvas.ground[pixel])
    if entry < 0:
        return ~entry
    tile = integer(canvas.counts[0])
    canvas.counts[0] = tile + 1
    canvas.owners[tile] = pixel
    canvas.ground[pixel] = ~tile
    colour = unpack(entry)
    for i in range(canvas.samples * canvas.samples):
        canvas.tiles[tile, i] = colour
    return tile


@merged
def paint(canvas: Canvas, low: int, high: int, colour: int) -> None:
    """Fill a scan-converted polygon on the ground, over what is there."""
    samples, size = canvas.samples, canvas.size
    flat = pack(colour)
    pad(canvas.spans, low, high, samples, size * samples)
    for y in range(low // samples, (high + samples - 1) // samples):
        row = y * size
        touched, covered, uncovered, end = pixel_spans(canvas.spans, y * samples, samples)
        for x in range(covered, uncovered):
            canvas.ground[row + x] = flat
        for first, last in ((touched, covered), (uncovered, end)):
            for x in range(first, last):
                _paint_part(canvas, row + x, mask(canvas.spans, y * samples, samples, x), colour)


@inlined
def _paint_part(canvas: Canvas, pixel: int, bits: int, colour: int) -> None:
    if bits:
        tile = open_tile(canvas, pixel)
        for i in range(canvas.samples * canvas.samples):
            under = canvas.tiles[tile, i]
            canvas.tiles[tile, i] = colour if bits >> i & 1 else under


@merged
def cover(canvas: Canvas, low: int, high: int, colour: int) -> None:
    """Fill a scan-converted polygon of a body, behind the bodies already there."""
    samples, size = canvas.samples, canvas.size
    full = EVERY_SAMPLE >> (16 - samples * samples)
    pad(canvas.spans, low, high, samples, size * samples)
    for y in range(low // samples, (high + samples - 1) // samples):
        row = y * size
        touched, covered, uncovered, end = pixel_spans(canvas.spans, y * samples, samples)
        canvas.touched[0, y] = minimum(canvas.touched[0, y], touched)
        canvas.touched[1, y] = maximum(canvas.touched[1, y], end)
        for x in range(covered, uncovered):
            _cover_part(canvas, row + x, full, colour)
        for first, last in ((touched, covered), (uncovered, end)):
            for x in range(first, last):
                _cover_part(canvas, row + x, mask(canvas.spans, y * samples, samples, x), colour)


@inlined
def _cover_part(canvas: Canvas, pixel: int, bits: int, colour: int) -> None:
    """Cover part of a pixel, without a branch, which the processor could not predict."""
    entry = integer(canvas.bodies[pixel])
    new = bits & (entry >> UNCOVERED)
    canvas.bodies[pixel] = (entry ^ (new << UNCOVERED)) + count_bits(new) * colour


@merged
def finish_ground(canvas: Canvas) -> None:
    """Average the tiles in `pixels`, except where bodies were composited over them."""
    samples = canvas.samples * canvas.samples
    for tile in range(canvas.counts[0]):
        pixel = canvas.owners[tile]
        if canvas.pixels[pixel] == ~tile:
            total = 0
            for i in range(samples):
                total += integer(canvas.tiles[tile, i])
            canvas.pixels[pixel] = pack(mean(total, samples))


@merged
def finish_bodies(canvas: Canvas) -> None:
    """Composite the bodies over the ground in `pixels` and clear them for the next frame."""
    samples, size = canvas.samples * canvas.samples, canvas.size
    full = EVERY_SAMPLE >> (16 - samples)
    untouched = full << UNCOVERED
    for y in range(size):
        for pixel in range(y * size + canvas.touched[0, y], y * size + canvas.touched[1, y]):
            entry = integer(canvas.bodies[pixel])
            if entry != untouched:
                canvas.bodies[pixel] = untouched
                total = entry & SUMS
                bits = (entry >> UNCOVERED) & full
                if bits:
                    total += _ground_sum(canvas, pixel, bits)
                canvas.pixels[pixel] = pack(mean(total, samples))
        canvas.touched[0, y], canvas.touched[1, y] = size, 0


@inlined
def _ground_sum(canvas: Canvas, pixel: int, bits: int) -> int:
    """The sum of the ground's colours over some samples of a pixel."""
    entry = integer(canvas.ground[pixel])
    if entry >= 0:
        return count_bits(bits) * unpack(entry)
    total = 0
    for i in range(canvas.samples * canvas.samples):
        if bits >> i & 1:
            total += integer(canvas.tiles[~entry, i])
    return total
