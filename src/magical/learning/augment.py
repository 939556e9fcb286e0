"""Image augmentation: noise, translation, rotation, colour jitter (appendix B).

The parameters are sampled once per frame stack; the noise alone is sampled for every pixel and
channel. Order: colour jitter, one combined rotation and translation, noise, clamp
(docs/specification.md, section 10). Everything runs batched on the images' own device.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from magical.learning.augmentations import Augmentations
from magical.learning.colour import colour_jitter

NOISE_STD = 0.01  # of the range [0, 1]
MAX_TRANSLATION = 0.05  # of the image's width and height
MAX_ROTATION = math.radians(5.0)
MAX_LIGHTNESS_CHANGE = 0.01  # factors from 0.99 to 1.01
MAX_COLOUR_ROTATION = 0.15  # rad in the (a, b) plane

PADDING_MODES = {"mirror": "reflection", "repeat": "border"}  # PyTorch's names
CPU_CHUNK = 4  # stacks at a time, so that intermediate results fit into a core's cache


def augment(images: Tensor, which: Augmentations, rng: np.random.Generator) -> Tensor:
    """Augment a batch of frame stacks.

    Args:
        images: (B, 3 * frames, H, W), uint8 or float in [0, 1]. Not changed.
        which: the augmentations to apply.
        rng: the source of all random numbers.

    Returns:
        (B, 3 * frames, H, W) float32 in [0, 1], in channels-last memory. Uint8 is scaled from
        [0, 255] whatever is switched on.
    """
    parameters = _sample_parameters(len(images), which, rng)
    generator = torch.Generator(images.device).manual_seed(int(rng.integers(2**63)))
    chunk = CPU_CHUNK if images.device.type == "cpu" else max(len(images), 1)
    out = torch.empty(images.shape, device=images.device, memory_format=torch.channels_last)
    for first in range(0, len(images), chunk):
        rows = slice(first, first + chunk)
        some = images[rows]
        if which.colour:
            some = colour_jitter(
                some, parameters.lightness[rows], parameters.hues[rows], which.linear_light
            )
        some = to_unit(some)
        if which.translation or which.rotation:
            some = warp(some, parameters.angles[rows], parameters.shifts[rows], which.borders)
        if which.noise:
            noise = torch.empty_like(some).normal_(0.0, NOISE_STD, generator=generator)
            some = noise.add_(some).clamp_(0.0, 1.0)
        out[rows] = some
    return out


def to_unit(observations: Tensor) -> Tensor:
    """Network inputs as float32: pixels (uint8) scaled to [0, 1], floats unchanged."""
    if observations.dtype != torch.uint8:
        return observations
    return observations.float().mul_(1.0 / 255.0)


def warp(
    images: Tensor,
    angles: NDArray[np.float64],
    shifts: NDArray[np.float64],
    borders: str = "mirror",
) -> Tensor:
    """Rotate each stack about its centre, then translate it.

    Args:
        images: (B, C, H, W) float.
        angles: (B,) radians, counter-clockwise as seen.
        shifts: (B, 2) to the right and down, as fractions of width and height.
        borders: what is beyond the image: "mirror", the image mirrored there, or "repeat", its
            outermost pixels.

    Returns:
        (B, C, H, W), bilinearly interpolated.
    """
    height, width = images.shape[2:]
    cos, sin = np.cos(angles), np.sin(angles)
    # grid_sample wants the inverse map: from output to input coordinates, each from -1 to 1.
    rotation = np.array([[cos, -sin * height / width], [sin * width / height, cos]])  # (2, 2, B)
    rotation = np.moveaxis(rotation, 2, 0)
    translation = -2.0 * np.einsum("bij,bj->bi", rotation, shifts)
    inverse = np.concatenate([rotation, translation[:, :, None]], axis=2)  # (B, 2, 3)
    theta = torch.from_numpy(inverse).to(images.device, images.dtype)
    grid = affine_grid(theta, list(images.shape), align_corners=False)
    return grid_sample(images, grid, padding_mode=PADDING_MODES[borders], align_corners=False)


@dataclass(frozen=True, slots=True)
class _Parameters:
    """Augmentation parameters, one row per stack."""

    lightness: NDArray[np.float64]  # (B,) factors
    hues: NDArray[np.float64]  # (B,) rotations in the (a, b) plane, rad
    angles: NDArray[np.float64]  # (B,) rad
    shifts: NDArray[np.float64]  # (B, 2), fractions of width and height


def _sample_parameters(count: int, which: Augmentations, rng: np.random.Generator) -> _Parameters:
    """Sample all parameters whatever is switched on, so that ablations share random numbers."""
    unit = rng.uniform(-1.0, 1.0, (count, 5))
    return _Parameters(
        lightness=1.0 + MAX_LIGHTNESS_CHANGE * unit[:, 0],
        hues=MAX_COLOUR_ROTATION * unit[:, 1],
        angles=MAX_ROTATION * unit[:, 2] * which.rotation,
        shifts=MAX_TRANSLATION * unit[:, 3:5] * which.translation,
    )
