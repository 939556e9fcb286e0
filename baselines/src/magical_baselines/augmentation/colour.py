"""CIE Lab colour jitter: its affine map, and its use on image batches in PyTorch, on any device.

In CIE 1976 Lab both lightness and the (a, b) plane are linear in the three cube roots of the
normalised XYZ values, so scaling L and rotating (a, b) is one affine map of these roots: Lab itself
is never computed. Source: appendix B, "Colour jitter"; sRGB as in IEC 61966-2-1, white point D65
for the 2 degree observer.

In PyTorch, powers are computed as exp(c * log(x)), several times faster than `pow` on a CPU.
"""

import math
from functools import cache

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


def decode_gamma(encoded: Floats) -> Floats:
    """Map sRGB values in [0, 1] to linear light."""
    curve = ((encoded + GAMMA_OFFSET) / GAMMA_SCALE) ** GAMMA
    return np.where(encoded > GAMMA_KNEE * GAMMA_SLOPE, curve, encoded / GAMMA_SLOPE)


def colour_jitter(
    images: Tensor, scales: Floats, hues: Floats, linear_light: bool = True
) -> Tensor:
    """Scale the lightness and rotate the (a, b) plane of each stack of frames.

    Args:
        images: (B, 3 * frames, H, W) sRGB, uint8 or float in [0, 1].
        scales: (B,) factors for L.
        hues: (B,) angles in radians, from a towards b.
        linear_light: decode sRGB to linear light before the conversion to XYZ, as the definition
            of XYZ requires, and encode it afterwards.

    Returns:
        Float images of the same shape, clamped to [0, 1]; all frames of a stack are changed alike.
    """
    batch, channels, height, width = images.shape
    linear = _decode_gamma(images) if linear_light else _to_float(images)
    linear = linear.reshape(batch, channels // 3, 3, height * width)
    to_xyz, from_xyz, lightness, cosine, sine, offset = _constants(images.device, linear.dtype)
    # As in `root_maps`.
    scale, hue = (torch.as_tensor(v).to(offset)[:, None, None] for v in (scales, hues))
    matrices = scale * lightness + hue.cos() * cosine + hue.sin() * sine  # (B, 3, 3)
    offsets = (scale - 1.0) * offset  # (B, 1, 3)
    roots = _to_roots(torch.matmul(to_xyz, linear))  # (B, frames, 3, H * W)
    roots = torch.matmul(matrices[:, None], roots).add_(offsets[..., None])
    linear = torch.matmul(from_xyz, _from_roots(roots))
    out = _encode_gamma(linear) if linear_light else linear
    return out.clamp_(0.0, 1.0).reshape(images.shape)


@cache
def _constants(device: torch.device, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """The maps' constants on a device, copied there once."""
    arrays = TO_TRISTIMULUS, FROM_TRISTIMULUS, LIGHTNESS, COSINE, SINE, OFFSET
    return tuple(torch.from_numpy(array).to(device, dtype) for array in arrays)


def _to_float(images: Tensor) -> Tensor:
    return images / 255.0 if images.dtype == torch.uint8 else images


def _decode_gamma(images: Tensor) -> Tensor:
    """Map sRGB to linear light; uint8 through a lookup table."""
    if images.dtype == torch.uint8:
        table = _decode_gamma(torch.arange(256, device=images.device) / 255.0)
        return table.index_select(0, images.flatten().int()).view(images.shape)
    knee = GAMMA_KNEE * GAMMA_SLOPE
    curve = images.clamp(min=knee).add_(GAMMA_OFFSET).div_(GAMMA_SCALE).log_().mul_(GAMMA).exp_()
    return curve.add_(images.clamp(max=knee).sub_(knee), alpha=1.0 / GAMMA_SLOPE)


def _encode_gamma(linear: Tensor) -> Tensor:
    curve = linear.clamp(min=GAMMA_KNEE).log_().mul_(1.0 / GAMMA).exp_().mul_(GAMMA_SCALE)
    line = linear.clamp_(max=GAMMA_KNEE)
    return curve.add_(line, alpha=GAMMA_SLOPE).sub_(GAMMA_OFFSET + GAMMA_SLOPE * GAMMA_KNEE)


def _to_roots(values: Tensor) -> Tensor:
    curve = values.clamp(min=ROOT_KNEE).log_().mul_(1.0 / 3.0).exp_()
    return curve.add_(values.clamp_(max=ROOT_KNEE).sub_(ROOT_KNEE), alpha=ROOT_SLOPE)


def _from_roots(roots: Tensor) -> Tensor:
    knee = math.cbrt(ROOT_KNEE)
    curve = roots.clamp(min=knee)
    curve *= curve * curve
    return curve.add_(roots.clamp_(max=knee).sub_(knee), alpha=1.0 / ROOT_SLOPE)
