"""CIE Lab colour jitter of image batches in PyTorch, on any device (see `lab`).

Powers are exp(c * log(x)), several times faster than `pow` on a CPU.
"""

import math
from functools import cache
from typing import NamedTuple

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
    constants = _constants(images.device, linear.dtype)
    matrices, offsets = _root_maps(scales, hues, constants)
    roots = _to_roots(torch.matmul(constants.to_tristimulus, linear))  # (B, frames, 3, H * W)
    roots = torch.matmul(matrices[:, None], roots).add_(offsets[:, None, :, None])
    linear = torch.matmul(constants.from_tristimulus, _from_roots(roots))
    out = _encode_gamma(linear) if linear_light else linear
    return out.clamp_(0.0, 1.0).reshape(images.shape)


class _Constants(NamedTuple):
    """The constants of `lab`, (3, 3) and (3,), on a device."""

    to_tristimulus: Tensor
    from_tristimulus: Tensor
    lightness: Tensor
    cosine: Tensor
    sine: Tensor
    offset: Tensor


@cache
def _constants(device: torch.device, dtype: torch.dtype) -> _Constants:
    """Copied to the device once: a CUDA graph must not read the host's memory."""
    arrays = lab.TO_TRISTIMULUS, lab.FROM_TRISTIMULUS, lab.LIGHTNESS, lab.COSINE, lab.SINE
    return _Constants(*(torch.from_numpy(a).to(device, dtype) for a in (*arrays, lab.OFFSET)))


def _root_maps(scales: Values, hues: Values, constants: _Constants) -> tuple[Tensor, Tensor]:
    """`lab.root_maps` on a device."""
    like = constants.offset
    scale, hue = (torch.as_tensor(v).to(like.device, like.dtype)[:, None] for v in (scales, hues))
    parts = constants.lightness, constants.cosine, constants.sine
    factors = scale, hue.cos(), hue.sin()
    matrices = sum(factor[:, None] * part for factor, part in zip(factors, parts, strict=True))
    return torch.as_tensor(matrices), (scale - 1.0) * like


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
