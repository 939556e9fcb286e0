"""Two layers that become a frame: the ground, painted back to front, and the bodies before it.

The ground (workspace, regions, lines) needs every sample's colour, because lines are blended with
what is under them; but only in pixels where there is more than one. The bodies are opaque and are
drawn front to back: a pixel remembers which of its samples are still uncovered and the sum of the
others' colours. Colours are added in 16-bit lanes (see `palette.lanes`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.render.jit import count_bits, inlined
from magical.render.polygons import Ints, mask, pad, pixel_spans

UNCOVERED = 48  # the lowest bit of a body pixel's mask; below it are the three lanes
ALL = 0xFFFF  # sixteen bits of mask
SUMS = 0xFFFFFFFFFFFF  # the three lanes
LANES = 0x00FF00FF00FF  # their low bytes


class Canvas(NamedTuple):
    """A frame's pixels, from the lowest row upwards, P = size * size of them.

    A ground pixel is a colour (red in the lowest byte), or ~t for tile t. Every layer of the
    ground opens at most one tile in a pixel. `pixels` starts as the ground and becomes the frame;
    where the ground is not to be kept, both are one array.
    """

    ground: NDArray[np.int32]  # (P,)
    tiles: Ints  # (layers * P, samples * samples): the samples of mixed ground pixels, as lanes
    owners: NDArray[np.int32]  # (layers * P,): the pixel that each tile belongs to
    counts: Ints  # (1,): number of tiles
    bodies: Ints  # (P,): mask of the uncovered samples, sum of the others' colours
    touched: Ints  # (2, size): in each row the first pixel that bodies touch, and the end
    pixels: NDArray[np.int32]  # (P,)
    size: int
    samples: int


def blank(samples: int) -> int:
    """A body pixel of which nothing is covered yet."""
    full = (1 << samples * samples) - 1
    return full << UNCOVERED if samples < 4 else -1 << UNCOVERED  # 64 bits, signed


@inlined
def squeeze(colour: int) -> int:
    """A colour of three lanes in three bytes."""
    return colour & 0xFF | colour >> 8 & 0xFF00 | colour >> 16 & 0xFF0000


@inlined
def spread(colour: int) -> int:
    """A colour of three bytes in three lanes."""
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
    """The ground pixel's tile; if it has none yet, one filled with its colour."""
    entry = int(canvas.ground[pixel])
    if entry < 0:
        return ~entry
    tile = int(canvas.counts[0])
    canvas.counts[0] = tile + 1
    canvas.owners[tile] = pixel
    canvas.ground[pixel] = ~tile
    colour = spread(entry)
    for i in range(canvas.samples * canvas.samples):
        canvas.tiles[tile, i] = colour
    return tile


@inlined
def paint(canvas: Canvas, spans: Ints, low: int, high: int, colour: int) -> None:
    """Fill a scanned polygon on the ground, over what is there."""
    samples, size = canvas.samples, canvas.size
    flat = squeeze(colour)
    pad(spans, low, high, samples, size * samples)
    for y in range(low // samples, (high + samples - 1) // samples):
        row = y * size
        touched, covered, uncovered, end = pixel_spans(spans, y * samples, samples)
        for x in range(touched, covered):
            _paint_part(canvas, row + x, mask(spans, y * samples, samples, x), colour)
        for x in range(covered, uncovered):
            canvas.ground[row + x] = flat
        for x in range(uncovered, end):
            _paint_part(canvas, row + x, mask(spans, y * samples, samples, x), colour)


@inlined
def _paint_part(canvas: Canvas, pixel: int, bits: int, colour: int) -> None:
    if bits:
        tile = open_tile(canvas, pixel)
        for i in range(canvas.samples * canvas.samples):
            under = canvas.tiles[tile, i]
            canvas.tiles[tile, i] = colour if bits >> i & 1 else under


@inlined
def cover(canvas: Canvas, spans: Ints, low: int, high: int, colour: int) -> None:
    """Fill a scanned polygon of a body, behind the bodies that are there."""
    samples, size = canvas.samples, canvas.size
    full = ALL >> (16 - samples * samples)
    pad(spans, low, high, samples, size * samples)
    for y in range(low // samples, (high + samples - 1) // samples):
        row = y * size
        touched, covered, uncovered, end = pixel_spans(spans, y * samples, samples)
        canvas.touched[0, y] = min(canvas.touched[0, y], touched)
        canvas.touched[1, y] = max(canvas.touched[1, y], end)
        for x in range(touched, covered):
            _cover_part(canvas, row + x, mask(spans, y * samples, samples, x), colour)
        for x in range(covered, uncovered):
            _cover_part(canvas, row + x, full, colour)
        for x in range(uncovered, end):
            _cover_part(canvas, row + x, mask(spans, y * samples, samples, x), colour)


@inlined
def _cover_part(canvas: Canvas, pixel: int, bits: int, colour: int) -> None:
    """Without a branch: whether a pixel is covered already is too irregular to be foreseen."""
    entry = int(canvas.bodies[pixel])
    new = bits & (entry >> UNCOVERED)
    canvas.bodies[pixel] = (entry ^ (new << UNCOVERED)) + count_bits(new) * colour


@inlined
def finish_ground(canvas: Canvas) -> None:
    """Average the ground's mixed pixels, unless bodies were laid over them, in `pixels`."""
    samples = canvas.samples * canvas.samples
    for tile in range(canvas.counts[0]):
        pixel = canvas.owners[tile]
        if canvas.pixels[pixel] == ~tile:
            total = 0
            for i in range(samples):
                total += int(canvas.tiles[tile, i])
            canvas.pixels[pixel] = squeeze(mean(total, samples))


@inlined
def finish_bodies(canvas: Canvas) -> None:
    """Lay the bodies over the ground in `pixels` and wipe them for the next frame."""
    samples, size = canvas.samples * canvas.samples, canvas.size
    full = ALL >> (16 - samples)
    untouched = full << UNCOVERED
    for y in range(size):
        for pixel in range(y * size + canvas.touched[0, y], y * size + canvas.touched[1, y]):
            entry = int(canvas.bodies[pixel])
            if entry != untouched:
                canvas.bodies[pixel] = untouched
                total = entry & SUMS
                bits = (entry >> UNCOVERED) & full
                if bits:
                    total += _ground_sum(canvas, pixel, bits)
                canvas.pixels[pixel] = squeeze(mean(total, samples))
        canvas.touched[0, y], canvas.touched[1, y] = size, 0


@inlined
def _ground_sum(canvas: Canvas, pixel: int, bits: int) -> int:
    """The sum of the ground's colours over some samples of a pixel."""
    entry = int(canvas.ground[pixel])
    if entry >= 0:
        return count_bits(bits) * spread(entry)
    total = 0
    for i in range(canvas.samples * canvas.samples):
        if bits >> i & 1:
            total += int(canvas.tiles[~entry, i])
    return total
