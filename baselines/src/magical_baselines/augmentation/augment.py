"""Image augmentation: noise, translation, rotation, colour jitter (appendix B).

Parameters are sampled once per frame stack; only noise is sampled for every pixel and channel. The
order is colour jitter, one combined rotation and translation, noise, clamp (docs/specification.md,
section 10). Images on a CPU are augmented by compiled code, those on a GPU by PyTorch.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from magical.errors import InvalidConfigError
from magical.render.renderer import CHANNELS
from magical_baselines.augmentation import kernels
from magical_baselines.augmentation.kernels import Floats
from magical_baselines.augmentation.names import Augmentations

NOISE_STD = 0.01  # of the range [0, 1]
MAX_TRANSLATION = 0.05  # of the image's width and height
MAX_ROTATION = math.radians(5.0)
MAX_LIGHTNESS_CHANGE = 0.01  # factors from 0.99 to 1.01
MAX_COLOUR_ROTATION = 0.15  # rad in the (a, b) plane

PADDING_MODES = {"mirror": "reflection", "repeat": "border"}  # PyTorch's names

Parameters = tuple[Floats, Floats, Floats, Floats]  # as of `sample_parameters`


def augment(
    images: Tensor, which: Augmentations, rng: np.random.Generator, together: int = 1
) -> Tensor:
    """Augment a batch of frame stacks.

    Args:
        images: (B, 3 * frames, H, W), uint8. Not changed.
        which: the augmentations to apply.
        rng: the source of all random numbers.
        together: the number of consecutive stacks that share their parameters.

    Returns:
        (B, 3 * frames, H, W) float32 in [0, 1], in channels-last memory.
    """
    if which.colour and images.shape[1] % CHANNELS:
        raise InvalidConfigError(
            f"augment: colour jitter needs RGB frames, found images of {images.shape[1]} channels; "
            "leave out colour"
        )
    parameters = sample_parameters(len(images), which, rng, together)
    if images.device.type == "cpu":
        seeds = rng.integers(2**64, size=len(images), dtype=np.uint64)
        return augment_compiled(images, which, parameters, seeds)
    generator = torch.Generator(images.device).manual_seed(int(rng.integers(2**63)))
    return augment_in_pytorch(images, which, parameters, generator)


def sample_parameters(
    count: int, which: Augmentations, rng: np.random.Generator, together: int = 1
) -> Parameters:
    """Sample the parameters of a batch; every `together` consecutive stacks share theirs.

    All are sampled whatever is switched on, so that ablations share random numbers.

    Returns:
        Factors of the lightness (B,); rotations in the (a, b) plane (B,) in radians; rotations (B,)
        in radians, counter-clockwise as seen; shifts (B, 2) to the right and down, as fractions of
        width and height.
    """
    unit = rng.uniform(-1.0, 1.0, (count // together, 5)).repeat(together, axis=0)
    return (
        1.0 + MAX_LIGHTNESS_CHANGE * unit[:, 0],
        MAX_COLOUR_ROTATION * unit[:, 1],
        MAX_ROTATION * unit[:, 2] * which.rotation,
        MAX_TRANSLATION * unit[:, 3:5] * which.translation,
    )


def augment_compiled(
    images: Tensor, which: Augmentations, parameters: Parameters, seeds: NDArray[np.uint64]
) -> Tensor:
    """`augment` on a CPU; `seeds` (B,) are for the noise."""
    batch, channels, height, width = images.shape
    lightness, hues, angles, shifts = parameters
    out = np.empty((batch, height, width, channels), np.float32)
    inverses = np.empty((0, 2, 3))
    if which.translation or which.rotation:
        maps = inverse_maps(angles, shifts, height, width).numpy()
        half = np.array([width / 2.0, height / 2.0])
        linear = maps[:, :, :2] * half[:, None] / half
        # From coordinates between -1 and 1 to pixels, whose centres are at whole numbers.
        offset = maps[:, :, 2] * half + (half - 0.5) - linear @ (half - 0.5)
        inverses = np.concatenate([linear, offset[:, :, None]], axis=2)
    jitter = kernels.root_maps(*(lightness, hues) if which.colour else np.empty((2, 0)))
    levels = np.arange(kernels.LEVELS + 1) / kernels.LEVELS
    decoded = kernels.decode_gamma(levels) if which.linear_light else levels
    mirror = which.borders == "mirror"
    kernels.resample(images.numpy(), inverses, *jitter, decoded, which.linear_light, mirror, out)
    if which.noise:
        kernels.add_noise(out, NOISE_STD, seeds)
    return torch.from_numpy(out).permute(0, 3, 1, 2)


def augment_in_pytorch(
    images: Tensor, which: Augmentations, parameters: Parameters, generator: torch.Generator
) -> Tensor:
    """`augment` on a GPU; the generator is for the noise."""
    lightness, hues, angles, shifts = parameters
    images = to_unit(images)
    if which.colour:
        images = colour_jitter(images, lightness, hues, which.linear_light)
    if which.translation or which.rotation:
        images = warp(images, angles, shifts, which.borders)
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
    theta = inverse_maps(angles, shifts, *images.shape[2:]).to(images)
    grid = affine_grid(theta, list(images.shape), align_corners=False)
    return grid_sample(images, grid, padding_mode=PADDING_MODES[borders], align_corners=False)


def inverse_maps(angles: Floats, shifts: Floats, height: int, width: int) -> Tensor:
    """The affine maps from output to input coordinates, for arguments as in `warp`: (B, 2, 3).

    Both coordinates, right and down, range from -1 to 1, as `grid_sample` expects.
    """
    turns = torch.from_numpy(angles)
    cos, sin = turns.cos(), turns.sin()
    rows = [cos, -sin * (height / width), sin * (width / height), cos]
    rotation = torch.stack(rows, dim=1).view(-1, 2, 2)
    translation = -2.0 * (rotation @ torch.from_numpy(shifts)[:, :, None])
    return torch.cat([rotation, translation], dim=2)


def _encode_gamma(linear: Tensor) -> Tensor:
    curve = kernels.GAMMA_SCALE * linear ** (1.0 / kernels.GAMMA) - kernels.GAMMA_OFFSET
    return torch.where(linear > kernels.GAMMA_KNEE, curve, kernels.GAMMA_SLOPE * linear)


def _to_roots(values: Tensor) -> Tensor:
    line = kernels.ROOT_OF_KNEE + kernels.ROOT_SLOPE * (values - kernels.ROOT_KNEE)
    return torch.where(values > kernels.ROOT_KNEE, values ** (1.0 / 3.0), line)


def _from_roots(roots: Tensor) -> Tensor:
    line = kernels.ROOT_KNEE + (roots - kernels.ROOT_OF_KNEE) / kernels.ROOT_SLOPE
    return torch.where(roots > kernels.ROOT_OF_KNEE, roots * roots * roots, line)


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
    arrays = kernels.TO_TRISTIMULUS, kernels.FROM_TRISTIMULUS, *kernels.root_maps(scales, hues)
    to_xyz, from_xyz, matrices, offsets = (torch.from_numpy(array).to(images) for array in arrays)
    linear = kernels.decode_gamma(images) if linear_light else images
    colours = linear.reshape(len(images), -1, 3, images.shape[2] * images.shape[3])
    roots = _to_roots(to_xyz @ colours)  # (B, frames, 3, H * W)
    changed = from_xyz @ _from_roots(matrices[:, None] @ roots + offsets[:, None, :, None])
    out = _encode_gamma(changed) if linear_light else changed
    return out.clamp(0.0, 1.0).reshape(images.shape)
