"""A batch of parsed scenes as tensors."""

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_goals.objects.parser import ABSENT, FAR, ParsedFrames

GRIP = 0.28  # units ahead of the robot's centre: where a gripped block's centre lies


class ObjectTable(NamedTuple):
    """The objects of B scenes, at most N blocks and M regions; float32 unless stated."""

    robot: Tensor  # (B, 3) x, y, angle
    fingers: Tensor  # (B, 2) opening angles of the left and the right finger, rad
    blocks: Tensor  # (B, N, 2); far away where absent
    colours: Tensor  # (B, N) int64, ABSENT (-1) where absent
    shapes: Tensor  # (B, N) int64
    regions: Tensor  # (B, M, 4) centre x and y, half width and half height
    region_colours: Tensor  # (B, M) int64

    def select(self, rows: Tensor | slice) -> "ObjectTable":
        """The scenes that an index selects."""
        return ObjectTable(*(column[rows] for column in self))

    def without(self, gone: Tensor) -> "ObjectTable":
        """The same scenes without some blocks, (B, N) bool."""
        return self._replace(
            blocks=self.blocks.masked_fill(gone[..., None], FAR),
            colours=self.colours.masked_fill(gone, ABSENT),
            shapes=self.shapes.masked_fill(gone, ABSENT),
        )

    @property
    def size(self) -> int:
        """The number of scenes."""
        return len(self.robot)

    @property
    def present(self) -> Tensor:
        """Which blocks exist, (B, N) bool."""
        return self.colours >= 0

    @property
    def grip(self) -> Tensor:
        """The point between the fingers, (B, 2)."""
        angle = self.robot[:, 2]
        return self.robot[:, :2] + GRIP * torch.stack([-angle.sin(), angle.cos()], dim=1)


def to_table(parsed: ParsedFrames, device: str | torch.device = "cpu") -> ObjectTable:
    """The objects of B frames as tensors on a device.

    There are as many block slots as the frames use, but at least two.
    """
    used = np.flatnonzero((parsed.colours != ABSENT).any(axis=0))
    count = 1 + max([1, *used.tolist()])
    names = ("blocks", "colours", "shapes")
    parsed = parsed._replace(**{name: getattr(parsed, name)[:, :count] for name in names})
    return ObjectTable(*(to_tensor(column).to(device) for column in parsed))


def to_tensor(array: NDArray[Any]) -> Tensor:
    """Floats as float32, integers as int64."""
    kind = np.float32 if array.dtype.kind == "f" else np.int64
    return torch.from_numpy(np.array(array, kind))
