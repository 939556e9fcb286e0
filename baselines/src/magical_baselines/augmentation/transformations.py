"""Transformations of demonstrations that are not in the paper: their names and sampling.

Each turns a stack of frames and its action into what a demonstrator could have seen and done in
another scene. They are applied to whole stacks, before the paper's augmentations.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.errors import InvalidConfigError, UnknownNameError
from magical.scene.actions import MIRRORED_ACTIONS
from magical.tasks import get_task
from magical_baselines.augmentation.palette import PERMUTATIONS

NONE = "none"
PALETTE, MIRROR, WALLS, FRAMES = "palette", "mirror", "walls", "frames"
TRANSFORMATIONS = {
    PALETTE: "the four colours of blocks and goal regions permuted",
    MIRROR: "mirror images, with left and right turns exchanged",
    WALLS: "the workspace's edge and what is beyond it in the workspace's colour",
    FRAMES: "the newest frame in place of all earlier ones",
}


def parse_transformations(text: str) -> frozenset[str]:
    """Parse `none`, or names of `TRANSFORMATIONS` joined by `+`, such as `mirror+frames`.

    Raises:
        UnknownNameError: a name is unknown.
    """
    chosen = frozenset() if text == NONE else frozenset(text.split("+"))
    for name in sorted(chosen - set(TRANSFORMATIONS)):
        raise UnknownNameError(
            f"transformation {name!r} is unknown; expected {NONE}, or some of "
            f"{', '.join(TRANSFORMATIONS)} joined by +"
        )
    return chosen


def check_transformations(chosen: frozenset[str], tasks: tuple[str, ...]) -> None:
    """Check that the tasks allow the transformations.

    Raises:
        InvalidConfigError: mirror images of a task that is not mirror-symmetric.
    """
    if MIRROR not in chosen:
        return
    for name in tasks:
        if not get_task(name).mirror_symmetric:
            raise InvalidConfigError(
                f"transform: expected tasks whose mirror images are scenes of the same task, found "
                f"{name}; leave out {MIRROR}"
            )


@dataclass(frozen=True, slots=True)
class StackTransformations:
    """How each of B stacks is transformed."""

    palettes: NDArray[np.int64]  # (B,) indices into `PERMUTATIONS`
    mirrored: NDArray[np.bool_]  # (B,)
    without_walls: NDArray[np.bool_]  # (B,)
    newest_only: NDArray[np.bool_]  # (B,)

    @classmethod
    def none(cls, count: int) -> Self:
        """Transformations that change nothing."""
        return cls(np.zeros(count, np.int64), *np.zeros((3, count), bool))

    @classmethod
    def sample(cls, count: int, chosen: frozenset[str], rng: np.random.Generator) -> Self:
        """Sample a permutation uniformly, and each other transformation with probability 1/2.

        If none is chosen, no random number is used.
        """
        if not chosen:
            return cls.none(count)
        palettes = rng.integers(len(PERMUTATIONS), size=count) * (PALETTE in chosen)
        halves = rng.random((3, count)) < 0.5
        switches = [[name in chosen] for name in (MIRROR, WALLS, FRAMES)]
        return cls(palettes, *(halves & switches))

    def labels(self, actions: Tensor) -> Tensor:
        """The actions (B,) int64 for the transformed stacks."""
        mirrored = torch.from_numpy(self.mirrored).to(actions.device)
        exchanged = torch.tensor(MIRRORED_ACTIONS, device=actions.device)
        return torch.where(mirrored, exchanged[actions], actions)
