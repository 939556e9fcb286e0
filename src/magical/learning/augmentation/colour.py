"""CIE Lab colour jitter of image batches in PyTorch, on any device (see `lab`).

Powers are exp(c * log(x)), several times faster than `pow` on a CPU.
"""

import math
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.learning.augmentation import lab
from magical.learning.augmentation.lab import (
    GAMMA,
    GAMMA_KNEE,
    GAMMA_OFFSET,
    GAMMA_SCALE,
    GAMMA_SLOPE,
    ROOT_KNEE,
    ROOT_SLOPE,
)

Values = NDArray[np.float64] | Tensor


def colour_jitter(
    images: Tensor, scales: Values, hues: Values, linear_light: bool = True
) -> Tensor:
    """Scale the lightness and rotate the (a, b) plane of each stack of frames.

    Args:
        images: (B, 3 * frames, H, W) sRGB, uint8 or float in [0, 1].
        scales: (B,) factors for L, an array, or a tensor on the images' device.
        hues: (B,) angles in radians, from a towards b, likewise.
        linear_light: decode sRGB to linear light before the conversion to XYZ, as its definition
            asks, and encode it afterwards.

    Returns:
        Float images of the same shape, clamped to [0, 1]; all frames of a stack are changed alike.
    """
    batch, channels, height, width = images.shape
    linear = _decode_gamma(images) if linear_light else _to_float(images)
    linear = linear.reshape(batch, channels // 3, 3, height * width)
    to_xyz, from_xyz, lightness, cosine, sine, offset = _constants(images.device, linear.dtype)
    # As `lab.root_maps` has them.
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
    """Those of `lab` on a device, copied there once."""
    arrays = lab.TO_TRISTIMULUS, lab.FROM_TRISTIMULUS, lab.LIGHTNESS, lab.COSINE, lab.SINE
    return tuple(torch.from_numpy(a).to(device, dtype) for a in (*arrays, lab.OFFSET))


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
