"""Permuting the palette of recorded frames, on any device.

Frames that are rendered from poses are rendered with another palette instead
(`magical_baselines.data.rendered_data`).
"""

from functools import cache
from itertools import permutations
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.errors import InvalidConfigError
from magical.render.palette import GREY, GREY_OUTLINE, OUTSIDE, PUPIL, SHADES, WHITE
from magical.render.palette import permuted as permuted_palette
from magical.scene.vocabulary import COLOURS

PERMUTATIONS = tuple(permutations(COLOURS))  # the first is the identity
BITS = 5  # per channel, by which a pixel's nearest colour is looked up
DROPPED = 8 - BITS


def permute_palette(images: Tensor, numbers: NDArray[np.int64]) -> Tensor:
    """Permute the palettes of frame stacks.

    A pixel changes by as much as the nearest colour of the palette does: exact where one colour
    fills the pixel, approximate at edges.

    Args:
        images: (B, 3 * frames, H, W) uint8.
        numbers: (B,) indices into `PERMUTATIONS`.

    Returns:
        The same shape, uint8.

    Raises:
        InvalidConfigError: images that are not RGB.
    """
    nearest, changes = _tables(images.device)
    batch, channels, height, width = images.shape
    if channels % 3:
        raise InvalidConfigError(
            f"transform: palette needs RGB frames, found images of {channels} channels"
        )
    frames = images.view(batch, channels // 3, 3, height, width)
    levels = (frames >> DROPPED).int()
    index = (levels[:, :, 0] << 2 * BITS) + (levels[:, :, 1] << BITS) + levels[:, :, 2]
    entries = nearest[index.flatten()].view(index.shape)  # (B, frames, H, W)
    own = changes[torch.from_numpy(numbers).to(images.device)]  # (B, n, 3)
    rows = torch.arange(len(images), device=images.device)[:, None, None, None]
    added = own[rows, entries].movedim(-1, 2)  # (B, frames, 3, H, W)
    permuted: Tensor = (frames + added).clamp_(0, 255).to(torch.uint8)
    return permuted.view(images.shape)


class _Tables(NamedTuple):
    nearest: Tensor  # (2^15,) int64: index of the palette's entry nearest to each colour
    changes: Tensor  # (24, n, 3) int16: what each permutation adds to each entry


@cache
def _tables(device: torch.device) -> _Tables:
    shades = [shade for colour in COLOURS for shade in SHADES[colour]]
    palette = np.array([*shades, WHITE, GREY, GREY_OUTLINE, OUTSIDE, PUPIL], np.uint8)
    middles = np.arange(1 << BITS) * (1 << DROPPED) + (1 << DROPPED) / 2
    grid = np.stack(np.meshgrid(middles, middles, middles, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = ((grid[:, None] - palette) ** 2).sum(axis=2)
    new = np.stack([permuted_palette(palette, colours) for colours in PERMUTATIONS])
    changes = new.astype(np.int16) - palette.astype(np.int16)
    nearest = torch.from_numpy(distances.argmin(axis=1))
    return _Tables(nearest.to(device), torch.from_numpy(changes).to(device))
