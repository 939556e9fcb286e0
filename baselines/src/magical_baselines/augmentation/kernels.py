"""Compiled augmentation of 8-bit frame stacks on a CPU: one pass over a stack, then its noise.

Noise is several times faster than from a general-purpose generator: each normal number is looked up
in a table by 14 random bits, and the table holds quantiles of the normal distribution, scaled to a
variance of exactly 1. The bits come from SplitMix64 (Steele, Lea and Flood, "Fast splittable
pseudorandom number generators", OOPSLA 2014), four numbers per output.
"""

from functools import cache, partial
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined, kernel
from magical.render.renderer import CHANNELS
from magical_baselines.augmentation.colour import (
    FROM_TRISTIMULUS,
    GAMMA,
    GAMMA_KNEE,
    GAMMA_OFFSET,
    GAMMA_SCALE,
    GAMMA_SLOPE,
    ROOT_KNEE,
    ROOT_OF_KNEE,
    ROOT_SLOPE,
    TO_TRISTIMULUS,
    decode_gamma,
)

LEVELS = 255  # of 8-bit pixels
SLOTS = 2048  # of the table of jittered colours: frames have a few hundred colours
MULTIPLIER = 2_654_435_761  # of the hash: 2^32 divided by the golden ratio
TABLE_BITS = 14
CHUNK = 1024  # noise is made for so many numbers at a time, which stay in the L1 cache
GOLDEN_GAMMA = np.uint64(0x9E3779B97F4A7C15)
LANE = np.uint64(16)  # bits of an output per number

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Packed = NDArray[np.int32]


def resample(
    images: NDArray[np.uint8],
    inverses: Floats | None,
    jitter: tuple[Floats, Floats] | None,
    linear_light: bool,
    mirror: bool,
    out: Floats32,
) -> None:
    """Jitter the colours of each stack, then rotate and translate it.

    Args:
        images: (B, C, H, W) uint8, of any memory layout.
        inverses: (B, 2, 3) affine maps from pixels (column, row) of the result to positions in the
            image, or None for no rotation and translation.
        jitter: matrices (B, 3, 3) and offsets (B, 3) as of `root_maps`, or None.
        linear_light: decode sRGB before the jitter, and encode it afterwards.
        mirror: mirror the image beyond its borders; otherwise repeat its outermost pixels.
        out: (B, H, W, C) float32, the results, bilinearly interpolated, in [0, 1].
    """
    maps = np.empty((0, 2, 3)) if inverses is None else inverses
    matrices, offsets = jitter or (np.empty((0, 3, 3)), np.empty((0, 3)))
    levels = np.arange(LEVELS + 1) / LEVELS
    decoded = decode_gamma(levels) if linear_light else levels  # (256,)
    compiled_resample(images, maps, matrices, offsets, decoded, linear_light, mirror, out)


def add_noise(images: Floats32, deviation: float, seeds: NDArray[np.uint64]) -> None:
    """Add normal noise to every number and clamp the results to [0, 1], in place.

    Args:
        images: (B, ...) float32, C-contiguous.
        deviation: standard deviation.
        seeds: (B,) uint64, one for each image, whose noise depends on nothing else.
    """
    table = (_normal_quantiles() * deviation).astype(np.float32)
    compiled_add_noise(images.reshape(len(images), -1), table, seeds)


@cache
def _normal_quantiles() -> Floats:
    count = 1 << TABLE_BITS
    normal = NormalDist()
    quantiles = np.array([normal.inv_cdf((i + 0.5) / count) for i in range(count)])
    return np.asarray(quantiles / quantiles.std())


@inlined
def _to_root(value: float) -> float:
    return (
        value ** (1.0 / 3.0)
        if value > ROOT_KNEE
        else ROOT_OF_KNEE + ROOT_SLOPE * (value - ROOT_KNEE)
    )


@inlined
def _from_root(root: float) -> float:
    line = ROOT_KNEE + (root - ROOT_OF_KNEE) / ROOT_SLOPE
    return root * root * root if root > ROOT_OF_KNEE else line


@inlined
def _encode_gamma(linear: float) -> float:
    line = GAMMA_SLOPE * linear
    if linear <= GAMMA_KNEE:
        return line
    return GAMMA_SCALE * float(linear ** (1.0 / GAMMA)) - GAMMA_OFFSET


@inlined
def _jittered(
    red: int,
    green: int,
    blue: int,
    matrix: Floats,
    offset: Floats,
    decoded: Floats,
    encodes: bool,
    out: Floats32,
) -> None:
    """Write one jittered colour to `out` (3,)."""
    linear = decoded[red], decoded[green], decoded[blue]
    roots, mixed = np.empty(CHANNELS), np.empty(CHANNELS)
    for i in range(CHANNELS):
        value = 0.0
        for k in range(CHANNELS):
            value += TO_TRISTIMULUS[i, k] * linear[k]
        roots[i] = _to_root(value)
    for i in range(CHANNELS):
        value = offset[i]
        for k in range(CHANNELS):
            value += matrix[i, k] * roots[k]
        mixed[i] = _from_root(value)
    for i in range(CHANNELS):
        value = 0.0
        for k in range(CHANNELS):
            value += FROM_TRISTIMULUS[i, k] * mixed[k]
        value = _encode_gamma(value) if encodes else value
        out[i] = min(max(value, 0.0), 1.0)


@inlined
def _reflect(place: float, size: int) -> float:
    """Mirror a coordinate at the borders, half a pixel beyond the outermost pixel centres."""
    if place < -0.5:
        place = -1.0 - place
    return 2.0 * size - 1.0 - place if place > size - 0.5 else place


@inlined
def _load(image: NDArray[np.uint8], pixels: Floats32) -> None:
    """Convert an image (C, H, W) to floats (H * W, C)."""
    channels, height, width = image.shape
    scale = np.float32(1.0 / LEVELS)
    for y in range(height):
        for x in range(width):
            for c in range(channels):
                pixels[y * width + x, c] = image[c, y, x] * scale


@inlined
def _pack(image: NDArray[np.uint8], packed: Packed) -> None:
    """Pack an image (C, H, W) into colours (H * W, C / 3) of three bytes."""
    height, width = image.shape[1], image.shape[2]
    for k in range(packed.shape[1]):
        reds, greens, blues = image[CHANNELS * k], image[CHANNELS * k + 1], image[CHANNELS * k + 2]
        for y in range(height):
            for x in range(width):
                red, green, blue = reds[y, x], greens[y, x], blues[y, x]
                packed[y * width + x, k] = (
                    np.int32(red) | np.int32(green) << 8 | np.int32(blue) << 16
                )


@inlined
def _jitter(
    packed: Packed,
    matrix: Floats,
    offset: Floats,
    decoded: Floats,
    encodes: bool,
    keys: Packed,
    values: Floats32,
    pixels: Floats32,
) -> None:
    """Write jittered colours (n,) to `pixels` (n, 3); the tables cache them by hash."""
    keys[:] = -1
    for i in range(len(packed)):
        key = packed[i]
        slot = np.int64(key) * MULTIPLIER >> 16 & SLOTS - 1
        if keys[slot] != key:
            keys[slot] = key
            red, green, blue = key & LEVELS, key >> 8 & LEVELS, key >> 16
            _jittered(red, green, blue, matrix, offset, decoded, encodes, values[slot])
        for k in range(CHANNELS):
            pixels[i, k] = values[slot, k]


@partial(inlined, fastmath={"contract"})  # a product and a sum may be rounded once together
def _warp(pixels: Floats32, inverse: Floats, mirror: bool, out: Floats32) -> None:
    """Rotate and translate pixels (H * W, C) into `out` (H, W, C)."""
    height, width = out.shape[0], out.shape[1]
    for y in range(height):
        for x in range(width):
            column = inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2]
            row = inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2]
            if mirror:
                column, row = _reflect(column, width), _reflect(row, height)
            column, row = min(max(column, 0.0), width - 1.0), min(max(row, 0.0), height - 1.0)
            left, top = int(column), int(row)
            across, down = np.float32(column - left), np.float32(row - top)
            right, below = min(left + 1, width - 1), min(top + 1, height - 1) * width
            top *= width
            both = across * down
            only_across, only_down = across - both, down - both
            neither = np.float32(1.0) - across - only_down
            a, b = pixels[top + left], pixels[top + right]
            c, d = pixels[below + left], pixels[below + right]
            new = out[y, x]
            for k in range(len(new)):
                new[k] = neither * a[k] + only_across * b[k] + only_down * c[k] + both * d[k]


@kernel
def compiled_resample(
    images: Any,
    inverses: Floats,
    matrices: Floats,
    offsets: Floats,
    decoded: Floats,
    encodes: bool,
    mirror: bool,
    out: Floats32,
) -> None:
    """See `resample`; empty `inverses` mean no warp, empty `matrices` no jitter."""
    channels, height, width = images.shape[1:]
    own = np.empty((height * width, channels), np.float32)
    packed = np.empty((height * width, channels // CHANNELS), np.int32)
    keys, values = np.empty(SLOTS, np.int32), np.empty((SLOTS, CHANNELS), np.float32)
    for b in range(len(images)):
        pixels = own if len(inverses) else out[b].reshape(height * width, channels)
        if len(matrices):
            _pack(images[b], packed)
            jitter = matrices[b], offsets[b], decoded, encodes
            _jitter(packed.ravel(), *jitter, keys, values, pixels.reshape(-1, CHANNELS))
        else:
            _load(images[b], pixels)
        if len(inverses):
            _warp(own, inverses[b], mirror, out[b])


@inlined
def _mixed(state: np.uint64) -> np.uint64:
    """SplitMix64's output for a state."""
    word = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return word ^ (word >> np.uint64(31))


@kernel
def compiled_add_noise(rows: Floats32, table: Floats32, seeds: NDArray[np.uint64]) -> None:
    """See `add_noise`: rows (B, n), a table of noise, seeds (B,)."""
    noise = np.empty(CHUNK, np.float32)
    last, zero, one = np.uint64(len(table) - 1), np.float32(0.0), np.float32(1.0)
    for b in range(len(rows)):
        state = seeds[b]
        for first in range(0, rows.shape[1], CHUNK):
            for i in range(0, CHUNK, 4):
                state += GOLDEN_GAMMA
                word = _mixed(state)
                noise[i] = table[word & last]
                noise[i + 1] = table[word >> LANE & last]
                noise[i + 2] = table[word >> (LANE + LANE) & last]
                noise[i + 3] = table[word >> (LANE + LANE + LANE) & last]
            some = rows[b, first : first + CHUNK]
            for i in range(len(some)):
                some[i] = min(max(some[i] + noise[i], zero), one)
