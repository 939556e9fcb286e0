"""CIE Lab colour jitter of image batches, fast.

In CIE 1976 Lab both lightness and the (a, b) plane are linear in the three cube roots of the
normalised XYZ values, so scaling L and rotating (a, b) is one affine map of these roots: Lab itself
is never computed. Powers are exp(c * log(x)), several times faster than `pow` on a CPU. Source:
appendix B, "Colour jitter"; sRGB as in IEC 61966-2-1, white D65 for the 2 degree observer.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

# Linear sRGB to XYZ, and the white point it is divided by.
SRGB_TO_XYZ = np.array(
    [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ]
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


def colour_jitter(
    images: Tensor,
    scales: NDArray[np.float64],
    hues: NDArray[np.float64],
    linear_light: bool = True,
) -> Tensor:
    """Scale the lightness and rotate the (a, b) plane of each stack of frames.

    Args:
        images: (B, 3 * frames, H, W) sRGB, uint8 or float in [0, 1].
        scales: (B,) factors for L.
        hues: (B,) angles in radians, from a towards b.
        linear_light: decode sRGB to linear light before the conversion to XYZ, as its definition
            asks, and encode it afterwards.

    Returns:
        Float images of the same shape, clamped to [0, 1]; all frames of a stack are changed alike.
    """
    batch, channels, height, width = images.shape
    linear = _decode_gamma(images) if linear_light else _to_float(images)
    linear = linear.reshape(batch, channels // 3, 3, height * width)
    matrices, offsets = (_like(array, linear) for array in root_maps(scales, hues))
    roots = _to_roots(_mix(TO_TRISTIMULUS, linear))  # (B, frames, 3, H * W)
    roots = torch.matmul(matrices[:, None], roots).add_(offsets[:, None, :, None])
    linear = _mix(FROM_TRISTIMULUS, _from_roots(roots))
    out = _encode_gamma(linear) if linear_light else linear
    return out.clamp_(0.0, 1.0).reshape(images.shape)


def root_maps(
    scales: NDArray[np.float64], hues: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The affine maps of the cube roots that the jitter amounts to: (B, 3, 3) and (B, 3)."""
    zero = np.zeros_like(scales)
    cos, sin = np.cos(hues), np.sin(hues)
    rows = [[scales, zero, zero], [zero, cos, -sin], [zero, sin, cos]]
    in_lab = np.moveaxis(np.array(rows), 2, 0)  # (B, 3, 3)
    matrices = LAB_TO_ROOTS @ in_lab @ ROOTS_TO_LAB
    offsets = (in_lab @ LAB_OFFSET - LAB_OFFSET) @ LAB_TO_ROOTS.T
    return matrices, offsets


def _like(array: NDArray[np.float64], tensor: Tensor) -> Tensor:
    return torch.from_numpy(array).to(tensor.device, tensor.dtype)


def _mix(matrix: NDArray[np.float64], pixels: Tensor) -> Tensor:
    return torch.matmul(_like(matrix, pixels), pixels)


def _to_float(images: Tensor) -> Tensor:
    return images / 255.0 if images.dtype == torch.uint8 else images


def _decode_gamma(images: Tensor) -> Tensor:
    """Map sRGB to linear; uint8 by a lookup table."""
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
