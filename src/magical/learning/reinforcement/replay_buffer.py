"""The buffer that discriminators sample the novice's half of a batch from."""

import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.learning.running.checkpoints import StateDict

ROLLOUTS = 4  # that the learners with learned rewards keep


class ReplayBuffer:
    """Observations (uint8) and actions of the newest rollouts, on their device."""

    def __init__(self, capacity: int, task_of: NDArray[np.int64]) -> None:
        """Create an empty buffer for `capacity` rollouts of environments of tasks (N,)."""
        self._capacity = capacity
        self._envs_of = [np.flatnonzero(task_of == number) for number in range(task_of.max() + 1)]
        self._task_of = task_of
        self._count = 0  # rollouts added in all
        self._observations: Tensor | None = None  # (capacity, T, N, ...)
        self._actions: Tensor | None = None  # (capacity, T, N)

    def add(self, observations: Tensor, actions: Tensor) -> None:
        """Add observations (T, N, ...) and actions (T, N), replacing the oldest rollout."""
        if self._observations is None or self._actions is None:
            self._observations = observations.new_zeros((self._capacity, *observations.shape))
            self._actions = actions.new_zeros((self._capacity, *actions.shape))
        self._observations[self._count % self._capacity] = observations
        self._actions[self._count % self._capacity] = actions
        self._count += 1

    def sample(
        self, counts: Sequence[int], rng: np.random.Generator
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Sample observations, actions and tasks, `counts[k]` of task k, with replacement.

        Returns, with B the sum of the counts:
            Observations (B, ...), actions (B,) int64, tasks (B,) int64.
        """
        assert self._observations is not None
        assert self._actions is not None
        pairs = zip(self._envs_of, counts, strict=True)
        env = np.concatenate([rng.choice(envs, count) for envs, count in pairs])
        size = len(env)
        rollout = rng.integers(min(self._count, self._capacity), size=size)
        time = rng.integers(self._actions.shape[1], size=size)
        device = self._actions.device
        index = tuple(torch.from_numpy(part).to(device) for part in (rollout, time, env))
        tasks = torch.from_numpy(self._task_of[env]).to(device)
        return self._observations[index], self._actions[index], tasks

    def state_dict(self) -> StateDict:
        """The contents; the images, which are mostly of uniform colour, are compressed."""
        assert self._observations is not None
        packed = zlib.compress(self._observations.cpu().numpy().tobytes(), 1)
        return {
            "count": self._count,
            "shape": list(self._observations.shape),
            "observations": torch.frombuffer(bytearray(packed), dtype=torch.uint8),
            "actions": self._actions,
        }

    def load_state_dict(self, state: Mapping[str, Any], device: str) -> None:
        """Restore what `state_dict` returned."""
        self._count = state["count"]
        plain = bytearray(zlib.decompress(state["observations"].numpy().tobytes()))
        images = torch.frombuffer(plain, dtype=torch.uint8).view(state["shape"])
        self._observations = images.to(device)
        self._actions = state["actions"].to(device)
