"""Compiled augmentation of 8-bit frame stacks on a CPU: one pass over a stack, then its noise.

In CIE 1976 Lab both lightness and the (a, b) plane are linear in the three cube roots of the
normalised XYZ values, so scaling L and rotating (a, b) is one affine map of these roots: Lab itself
is never computed. Source: appendix B, "Colour jitter"; sRGB as in IEC 61966-2-1, white point D65
for the 2 degree observer.

Noise is several times faster than from a general-purpose generator: each normal number is looked up
in a table by 14 random bits, and the table holds quantiles of the normal distribution, scaled to a
variance of exactly 1. The bits come from SplitMix64 (Steele, Lea and Flood, "Fast splittable
pseudorandom number generators", OOPSLA 2014), four numbers per output.
"""

import math
from functools import cache, partial
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined, kernel
from magical.render.renderer import CHANNELS

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


# Linear sRGB to XYZ, and the white point it is divided by.
SRGB_TO_XYZ = np.array(
    [[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]]
)
WHITE = np.array([0.95047, 1.0, 1.08883])
TO_TRISTIMULUS = SRGB_TO_XYZ / WHITE[:, None]  # linear sRGB to XYZ relative to white
FROM_TRISTIMULUS = np.linalg.inv(TO_TRISTIMULUS)

# L = 116 fy - 16, a = 500 (fx - fy), b = 200 (fy - fz), with f the (extended) cube roots.
ROOTS_TO_LAB = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])
LAB_OFFSET = np.array([-16.0, 0.0, 0.0])
LAB_TO_ROOTS = np.linalg.inv(ROOTS_TO_LAB)

# Near black, below these arguments, the power functions are replaced by straight lines.
ROOT_KNEE, ROOT_SLOPE = 0.008856, 7.787
ROOT_OF_KNEE = math.cbrt(ROOT_KNEE)
GAMMA, GAMMA_SCALE, GAMMA_OFFSET = 2.4, 1.055, 0.055
GAMMA_KNEE, GAMMA_SLOPE = 0.0031308, 12.92


def _of_roots(in_lab: Floats) -> Floats:
    """Express a linear map of Lab colours (without the offset) in the cube roots: (3, 3)."""
    return np.asarray(LAB_TO_ROOTS @ in_lab @ ROOTS_TO_LAB)


# A jitter's map is scale * LIGHTNESS + cos(hue) * COSINE + sin(hue) * SINE, plus the offset
# (scale - 1) * OFFSET.
LIGHTNESS = _of_roots(np.diag([1.0, 0.0, 0.0]))
COSINE = _of_roots(np.diag([0.0, 1.0, 1.0]))
SINE = _of_roots(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
OFFSET = LAB_TO_ROOTS @ LAB_OFFSET


def root_maps(scales: Floats, hues: Floats) -> tuple[Floats, Floats]:
    """The jitter as affine maps of the cube roots: matrices (B, 3, 3) and offsets (B, 3).

    L is multiplied by the scales (B,), and (a, b) turned by the hues (B,) in radians.
    """
    scale, cos, sin = (v[:, None, None] for v in (scales, np.cos(hues), np.sin(hues)))
    return scale * LIGHTNESS + cos * COSINE + sin * SINE, (scales[:, None] - 1.0) * OFFSET


def decode_gamma(encoded: Any) -> Any:
    """Map sRGB values in [0, 1], of an array or a tensor, to linear light."""
    above = encoded > GAMMA_KNEE * GAMMA_SLOPE
    curve = ((encoded + GAMMA_OFFSET) / GAMMA_SCALE) ** GAMMA
    return above * curve + ~above * (encoded / GAMMA_SLOPE)


def add_noise(images: Floats32, deviation: float, seeds: NDArray[np.uint64]) -> None:
    """Add normal noise to images (B, ...), C-contiguous, and clamp them to [0, 1], in place.

    The noise of an image has a standard deviation and depends on its seed, of (B,), alone.
    """
    table = (_normal_quantiles() * deviation).astype(np.float32)
    _add_noise(images.reshape(len(images), -1), table, seeds)


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
    roots, mixed = np.empty(CHANNELS), np.empty(CHANNELS)
    for n in range(len(packed)):
        key = packed[n]
        slot = np.int64(key) * MULTIPLIER >> 16 & SLOTS - 1
        if keys[slot] != key:
            keys[slot] = key
            linear = decoded[key & LEVELS], decoded[key >> 8 & LEVELS], decoded[key >> 16]
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
                values[slot, i] = min(max(value, 0.0), 1.0)
        for k in range(CHANNELS):
            pixels[n, k] = values[slot, k]


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
def resample(
    images: Any,
    inverses: Floats,
    matrices: Floats,
    offsets: Floats,
    decoded: Floats,
    encodes: bool,
    mirror: bool,
    out: Floats32,
) -> None:
    """Jitter the colours of each stack, then rotate and translate it.

    Args:
        images: (B, C, H, W) uint8, of any memory layout.
        inverses: (B, 2, 3) affine maps from pixels (column, row) of the result to positions in the
            image; empty for no rotation and translation.
        matrices: (B, 3, 3) of `root_maps`; empty for no jitter.
        offsets: (B, 3) of `root_maps`.
        decoded: (256,) linear light of each level, or the levels themselves.
        encodes: encode sRGB after the jitter, as the levels have been decoded.
        mirror: mirror the image beyond its borders; otherwise repeat its outermost pixels.
        out: (B, H, W, C) float32, the results, bilinearly interpolated, in [0, 1].
    """
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
def _add_noise(rows: Floats32, table: Floats32, seeds: NDArray[np.uint64]) -> None:
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
