"""CIE Lab colour jitter as an affine map, and its use on image batches in PyTorch (on a GPU).

In CIE 1976 Lab both lightness and the (a, b) plane are linear in the three cube roots of the
normalised XYZ values, so scaling L and rotating (a, b) is one affine map of these roots: Lab itself
is never computed. Source: appendix B, "Colour jitter"; sRGB as in IEC 61966-2-1, white point D65
for the 2 degree observer.
"""

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Floats = NDArray[np.float64]

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

    Args:
        scales: (B,) factors for L.
        hues: (B,) angles in radians, from a towards b.
    """
    scale, cos, sin = (v[:, None, None] for v in (scales, np.cos(hues), np.sin(hues)))
    return scale * LIGHTNESS + cos * COSINE + sin * SINE, (scales[:, None] - 1.0) * OFFSET


def decode_gamma(encoded: Any) -> Any:
    """Map sRGB values in [0, 1], of an array or a tensor, to linear light."""
    above = encoded > GAMMA_KNEE * GAMMA_SLOPE
    curve = ((encoded + GAMMA_OFFSET) / GAMMA_SCALE) ** GAMMA
    return above * curve + ~above * (encoded / GAMMA_SLOPE)


def _encode_gamma(linear: Tensor) -> Tensor:
    curve = GAMMA_SCALE * linear ** (1.0 / GAMMA) - GAMMA_OFFSET
    return torch.where(linear > GAMMA_KNEE, curve, GAMMA_SLOPE * linear)


def _to_roots(values: Tensor) -> Tensor:
    line = ROOT_OF_KNEE + ROOT_SLOPE * (values - ROOT_KNEE)
    return torch.where(values > ROOT_KNEE, values ** (1.0 / 3.0), line)


def _from_roots(roots: Tensor) -> Tensor:
    line = ROOT_KNEE + (roots - ROOT_OF_KNEE) / ROOT_SLOPE
    return torch.where(roots > ROOT_OF_KNEE, roots * roots * roots, line)


def colour_jitter(
    images: Tensor, scales: Floats, hues: Floats, linear_light: bool = True
) -> Tensor:
    """Scale the lightness and rotate the (a, b) plane of each stack of frames.

    Args:
        images: (B, 3 * frames, H, W) float sRGB in [0, 1].
        scales: (B,) factors for L.
        hues: (B,) angles in radians, from a towards b.
        linear_light: decode sRGB to linear light before the conversion to XYZ, as the definition
            of XYZ requires, and encode it afterwards.

    Returns:
        Images of the same shape, clamped to [0, 1]; all frames of a stack are changed alike.
    """
    arrays = TO_TRISTIMULUS, FROM_TRISTIMULUS, *root_maps(scales, hues)
    to_xyz, from_xyz, matrices, offsets = (torch.from_numpy(array).to(images) for array in arrays)
    linear = decode_gamma(images) if linear_light else images
    colours = linear.reshape(len(images), -1, 3, images.shape[2] * images.shape[3])
    roots = _to_roots(to_xyz @ colours)  # (B, frames, 3, H * W)
    changed = from_xyz @ _from_roots(matrices[:, None] @ roots + offsets[:, None, :, None])
    out = _encode_gamma(changed) if linear_light else changed
    return out.clamp(0.0, 1.0).reshape(images.shape)
