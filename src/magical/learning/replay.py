"""The newest experience, from which discriminators draw the novice's half of a batch."""

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.learning.checkpoints import Tree


class Replay:
    """Observations (or features) and actions of the last few sampler batches, on their device."""

    def __init__(self, capacity: int, task_of: NDArray[np.int64]) -> None:
        """`capacity` is in sampler batches; `task_of` (N,) tells each world's task."""
        self._capacity = capacity
        self._worlds = [np.flatnonzero(task_of == number) for number in range(task_of.max() + 1)]
        self._task_of = task_of
        self._count = 0  # batches seen in all
        self._observations: Tensor | None = None  # (capacity, T, N, ...)
        self._actions: Tensor | None = None  # (capacity, T, N)

    def add(self, observations: Tensor, actions: Tensor) -> None:
        """Keep a copy of (T, N, ...) observations and (T, N) actions; forget the oldest."""
        if self._observations is None or self._actions is None:
            self._observations = observations.new_zeros((self._capacity, *observations.shape))
            self._actions = actions.new_zeros((self._capacity, *actions.shape))
        self._observations[self._count % self._capacity] = observations
        self._actions[self._count % self._capacity] = actions
        self._count += 1

    def sample_evenly(self, size: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Observations (B, ...), actions (B,) and tasks (B,), with replacement.

        They are split evenly between the tasks; the first ones get the rest.
        """
        assert self._observations is not None
        assert self._actions is not None
        share, rest = divmod(size, len(self._worlds))
        world = np.concatenate(
            [rng.choice(worlds, share + (n < rest)) for n, worlds in enumerate(self._worlds)]
        )
        batch = rng.integers(min(self._count, self._capacity), size=size)
        time = rng.integers(self._actions.shape[1], size=size)
        device = self._actions.device
        where = tuple(torch.from_numpy(index).to(device) for index in (batch, time, world))
        tasks = torch.from_numpy(self._task_of[world]).to(device)
        return self._observations[where], self._actions[where], tasks

    def tree(self) -> Tree:
        """For a checkpoint; images, which are mostly flat colour, are compressed."""
        assert self._observations is not None
        return {
            "count": self._count,
            "shape": list(self._observations.shape),
            "observations": _pack(self._observations),
            "actions": self._actions,
        }

    def load(self, tree: Mapping[str, Any], device: str) -> None:
        """Continue from what `tree` returned."""
        self._count = tree["count"]
        self._observations = _unpack(tree["observations"], tree["shape"]).to(device)
        self._actions = tree["actions"].to(device)


def _pack(tensor: Tensor) -> Tensor:
    if tensor.dtype != torch.uint8:
        return tensor
    packed = zlib.compress(tensor.cpu().numpy().tobytes(), 1)
    return torch.frombuffer(bytearray(packed), dtype=torch.uint8)


def _unpack(tensor: Tensor, shape: list[int]) -> Tensor:
    if tensor.dtype != torch.uint8:
        return tensor
    plain = bytearray(zlib.decompress(tensor.numpy().tobytes()))
    return torch.frombuffer(plain, dtype=torch.uint8).view(shape)
