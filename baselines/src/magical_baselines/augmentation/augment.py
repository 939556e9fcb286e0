"""Image augmentation: noise, translation, rotation, colour jitter (appendix B).

Parameters are sampled once per frame stack; only noise is sampled for every pixel and channel. The
order is colour jitter, one combined rotation and translation, noise, clamp (docs/specification.md,
section 10). 8-bit images on a CPU are augmented by compiled code, all others in batches by PyTorch
on their own device; tests compare the compiled code with PyTorch as the reference.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from magical.errors import InvalidConfigError
from magical.render.output import CHANNELS
from magical_baselines.augmentation.colour import colour_jitter
from magical_baselines.augmentation.names import Augmentations
from magical_baselines.augmentation.noise import add_noise
from magical_baselines.augmentation.resampling import resample

NOISE_STD = 0.01  # of the range [0, 1]
MAX_TRANSLATION = 0.05  # of the image's width and height
MAX_ROTATION = math.radians(5.0)
MAX_LIGHTNESS_CHANGE = 0.01  # factors from 0.99 to 1.01
MAX_COLOUR_ROTATION = 0.15  # rad in the (a, b) plane

PADDING_MODES = {"mirror": "reflection", "repeat": "border"}  # PyTorch's names
NUM_PARAMETERS = 5  # per stack

Floats = NDArray[np.float64]


def augment(
    images: Tensor, which: Augmentations, rng: np.random.Generator, together: int = 1
) -> Tensor:
    """Augment a batch of frame stacks; uint8 stacks on a CPU in compiled code.

    Args:
        images: (B, 3 * frames, H, W), uint8 or float in [0, 1]. Not changed.
        which: the augmentations to apply.
        rng: the source of all random numbers.
        together: the number of consecutive stacks that share their parameters.

    Returns:
        (B, 3 * frames, H, W) float32 in [0, 1], in channels-last memory. Uint8 is scaled from
        [0, 255] whichever augmentations are on.
    """
    if which.colour and images.shape[1] % CHANNELS:
        raise InvalidConfigError(
            f"augment: colour jitter needs RGB frames, found images of {images.shape[1]} channels; "
            "leave out colour"
        )
    parameters = sample_parameters(len(images), which, rng, together)
    if images.device.type == "cpu" and images.dtype == torch.uint8:
        return resampled(images, which, parameters, noise_seeds(len(images), rng))
    generator = torch.Generator(images.device).manual_seed(int(rng.integers(2**63)))
    return augment_in_pytorch(images, which, parameters, generator)


def resampled(
    images: Tensor, which: Augmentations, parameters: "Parameters", seeds: NDArray[np.uint64]
) -> Tensor:
    """`augment` in compiled code, for uint8 images on a CPU; `seeds` (B,) are for the noise."""
    batch, channels, height, width = images.shape
    out = np.empty((batch, height, width, channels), np.float32)
    inverses = None
    if which.translation or which.rotation:
        angles = torch.from_numpy(parameters.angles)
        maps = inverse_maps(angles, torch.from_numpy(parameters.shifts), height, width)
        inverses = in_pixels(maps.numpy(), height, width)
    jitter = (parameters.lightness, parameters.hues) if which.colour else None
    mirror = which.borders == "mirror"
    resample(images.numpy(), inverses, jitter, which.linear_light, mirror, out)
    if which.noise:
        add_noise(out, NOISE_STD, seeds)
    return torch.from_numpy(out).permute(0, 3, 1, 2)


def augment_in_pytorch(
    images: Tensor, which: Augmentations, parameters: "Parameters", generator: torch.Generator
) -> Tensor:
    """`augment` in PyTorch, on any device; the generator is for the noise."""
    if which.colour:
        images = colour_jitter(images, parameters.lightness, parameters.hues, which.linear_light)
    images = to_unit(images)
    if which.translation or which.rotation:
        images = warp(images, parameters.angles, parameters.shifts, which.borders)
    if which.noise:
        noise = torch.empty_like(images).normal_(0.0, NOISE_STD, generator=generator)
        images = noise.add_(images).clamp_(0.0, 1.0)
    return images.contiguous(memory_format=torch.channels_last)


def to_unit(observations: Tensor) -> Tensor:
    """Network inputs as float32: pixels (uint8) scaled to [0, 1], floats unchanged."""
    if observations.dtype != torch.uint8:
        return observations
    return observations.float().mul_(1.0 / 255.0)


def warp(images: Tensor, angles: Floats, shifts: Floats, borders: str = "mirror") -> Tensor:
    """Rotate each stack about its centre, then translate it.

    Args:
        images: (B, C, H, W) float.
        angles: (B,) radians, counter-clockwise as seen.
        shifts: (B, 2) to the right and down, as fractions of width and height.
        borders: how the image continues beyond its borders: "mirror", mirrored, or "repeat", with
            its outermost pixels repeated.

    Returns:
        (B, C, H, W), bilinearly interpolated.
    """
    height, width = images.shape[2:]
    # grid_sample expects the inverse map: from output to input coordinates, each from -1 to 1.
    turns, moves = (torch.as_tensor(v, device=images.device) for v in (angles, shifts))
    theta = inverse_maps(turns, moves, height, width).to(images.dtype)
    grid = affine_grid(theta, list(images.shape), align_corners=False)
    return grid_sample(images, grid, padding_mode=PADDING_MODES[borders], align_corners=False)


def inverse_maps(angles: Tensor, shifts: Tensor, height: int, width: int) -> Tensor:
    """The affine maps from output to input coordinates, for arguments as in `warp`: (B, 2, 3).

    Both coordinates, right and down, range from -1 to 1.
    """
    cos, sin = angles.cos(), angles.sin()
    rows = [cos, -sin * (height / width), sin * (width / height), cos]
    rotation = torch.stack(rows, dim=1).view(-1, 2, 2)
    translation = -2.0 * (rotation @ shifts[:, :, None])
    return torch.cat([rotation, translation], dim=2)


def in_pixels(maps: Floats, height: int, width: int) -> Floats:
    """Convert these maps (B, 2, 3) to columns and rows, with pixel centres at whole numbers."""
    half = np.array([width / 2.0, height / 2.0])
    linear = maps[:, :, :2] * half[:, None] / half
    centre = half - 0.5
    offset = maps[:, :, 2] * half + centre - linear @ centre
    return np.concatenate([linear, offset[:, :, None]], axis=2)


@dataclass(frozen=True, slots=True)
class Parameters:
    """Augmentation parameters, one row per stack."""

    lightness: Floats  # (B,) factors
    hues: Floats  # (B,) rotations in the (a, b) plane, rad
    angles: Floats  # (B,) rad, counter-clockwise as seen
    shifts: Floats  # (B, 2), right and down, fractions of width and height


def sample_parameters(
    count: int, which: Augmentations, rng: np.random.Generator, together: int = 1
) -> Parameters:
    """Sample the parameters of a batch; every `together` consecutive stacks share theirs.

    All columns are sampled whatever is switched on, so that ablations share random numbers.
    """
    unit = rng.uniform(-1.0, 1.0, (count // together, NUM_PARAMETERS)).repeat(together, axis=0)
    return Parameters(
        lightness=1.0 + MAX_LIGHTNESS_CHANGE * unit[:, 0],
        hues=MAX_COLOUR_ROTATION * unit[:, 1],
        angles=MAX_ROTATION * which.scale * unit[:, 2] * which.rotation,
        shifts=MAX_TRANSLATION * which.scale * unit[:, 3:5] * which.translation,
    )


def noise_seeds(count: int, rng: np.random.Generator) -> NDArray[np.uint64]:
    """A noise seed for each stack of a batch: (B,)."""
    return rng.integers(2**64, size=count, dtype=np.uint64)
