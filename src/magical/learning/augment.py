"""Image augmentations: noise, translation, rotation, colour jitter (appendix B).

One draw a stack, different draws in a batch; the noise alone is drawn anew for every pixel and
channel. Order: colour jitter, one combined rotation and translation with mirrored borders, noise,
clamp (docs/specification.md, section 10). Everything runs batched on the images' own device.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from magical.errors import UnknownNameError
from magical.learning.colour import colour_jitter

NOISE_STD = 0.01  # of the range [0, 1]
MAX_TRANSLATION = 0.05  # of the image's width and height
MAX_ROTATION = math.radians(5.0)
MAX_LIGHTNESS_CHANGE = 0.01  # factors from 0.99 to 1.01
MAX_COLOUR_TURN = 0.15  # rad in the (a, b) plane

CPU_CHUNK = 4  # stacks at a time: what is worked on stays in a core's cache


@dataclass(frozen=True, slots=True)
class Augmentations:
    """Which augmentations are switched on."""

    noise: bool = True
    translation: bool = True
    rotation: bool = True
    colour: bool = True


NAMES = tuple(field.name for field in fields(Augmentations))
SETS = {
    "all": Augmentations(),
    "no-trans-rot": Augmentations(translation=False, rotation=False),
    "none": Augmentations(False, False, False, False),
}


def parse_augmentations(text: str) -> Augmentations:
    """One of `SETS`, or names joined by `+`, such as `noise+rotation`.

    `no-trans-rot` and `none` are the tables' "no trans./rot. aug." and "no aug.".

    Raises:
        UnknownNameError: a name that is none of these.
    """
    if text in SETS:
        return SETS[text]
    chosen = text.split("+")
    unknown = [name for name in chosen if name not in NAMES]
    if unknown:
        raise UnknownNameError(
            f"augmentation {unknown[0]!r} is unknown; expected one of {', '.join(SETS)}, or some "
            f"of {', '.join(NAMES)} joined by +"
        )
    return Augmentations(**{name: name in chosen for name in NAMES})


def augment(images: Tensor, which: Augmentations, rng: np.random.Generator) -> Tensor:
    """Augment a batch of frame stacks.

    Args:
        images: (B, 3 * frames, H, W), uint8 or float in [0, 1]. Not changed.
        which: what to do.
        rng: the source of every draw.

    Returns:
        (B, 3 * frames, H, W) float32 in [0, 1], in channels-last memory. Uint8 is scaled from
        [0, 255] whatever is switched on.
    """
    draws = _draw(len(images), which, rng)
    generator = torch.Generator(images.device).manual_seed(int(rng.integers(2**63)))
    chunk = CPU_CHUNK if images.device.type == "cpu" else max(len(images), 1)
    out = torch.empty(images.shape, device=images.device, memory_format=torch.channels_last)
    for first in range(0, len(images), chunk):
        rows = slice(first, first + chunk)
        some = images[rows]
        if which.colour:
            some = colour_jitter(some, draws.scales[rows], draws.turns[rows])
        some = to_unit(some)
        if which.translation or which.rotation:
            some = warp(some, draws.angles[rows], draws.shifts[rows])
        if which.noise:
            noise = torch.empty_like(some).normal_(0.0, NOISE_STD, generator=generator)
            some = noise.add_(some).clamp_(0.0, 1.0)
        out[rows] = some
    return out


def to_unit(images: Tensor) -> Tensor:
    """Pixels as float32 in [0, 1]; floats are left as they are."""
    return images.float().mul_(1.0 / 255.0) if images.dtype == torch.uint8 else images


def warp(images: Tensor, angles: NDArray[np.float64], shifts: NDArray[np.float64]) -> Tensor:
    """Turn each stack around its centre, then move it, mirroring at the borders.

    Args:
        images: (B, C, H, W) float.
        angles: (B,) radians, counter-clockwise as seen.
        shifts: (B, 2) to the right and down, as fractions of width and height.

    Returns:
        (B, C, H, W), bilinearly interpolated.
    """
    height, width = images.shape[2:]
    cos, sin = np.cos(angles), np.sin(angles)
    # Rows say where an output pixel is found in the input, in coordinates from -1 to 1.
    turn = np.array([[cos, -sin * height / width], [sin * width / height, cos]])  # (2, 2, B)
    turn = np.moveaxis(turn, 2, 0)
    moved = -2.0 * np.einsum("bij,bj->bi", turn, shifts)
    inverse = np.concatenate([turn, moved[:, :, None]], axis=2)  # (B, 2, 3)
    theta = torch.from_numpy(inverse).to(images.device, images.dtype)
    grid = affine_grid(theta, list(images.shape), align_corners=False)
    return grid_sample(images, grid, padding_mode="reflection", align_corners=False)


@dataclass(frozen=True, slots=True)
class _Draws:
    """One row for each stack."""

    scales: NDArray[np.float64]  # (B,) of lightness
    turns: NDArray[np.float64]  # (B,) of colour, rad
    angles: NDArray[np.float64]  # (B,) rad
    shifts: NDArray[np.float64]  # (B, 2) of width and height


def _draw(count: int, which: Augmentations, rng: np.random.Generator) -> _Draws:
    """Everything is drawn whatever is switched on, so that ablations share their draws."""
    unit = rng.uniform(-1.0, 1.0, (count, 5))
    return _Draws(
        scales=1.0 + MAX_LIGHTNESS_CHANGE * unit[:, 0],
        turns=MAX_COLOUR_TURN * unit[:, 1],
        angles=MAX_ROTATION * unit[:, 2] * which.rotation,
        shifts=MAX_TRANSLATION * unit[:, 3:5] * which.translation,
    )
