"""The replay buffer from which discriminators sample the novice's half of a batch."""

import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_baselines.running.checkpoints import StateDict

ROLLOUTS = 4  # kept by the learners with learned rewards


class ReplayBuffer:
    """Observations (uint8) and actions of the newest rollouts, on their device."""

    _observations: Tensor  # (capacity, T, N, ...), allocated with the first rollout
    _actions: Tensor  # (capacity, T, N)

    def __init__(self, capacity: int, task_of: NDArray[np.int64]) -> None:
        """Create an empty buffer for `capacity` rollouts of environments with tasks (N,)."""
        self._capacity = capacity
        self._envs_of = [np.flatnonzero(task_of == number) for number in range(task_of.max() + 1)]
        self._task_of = task_of
        self._count = 0  # rollouts added in total

    def add(self, observations: Tensor, actions: Tensor) -> None:
        """Add observations (T, N, ...) and actions (T, N), replacing the oldest rollout."""
        if not self._count:
            self._observations = observations.new_zeros((self._capacity, *observations.shape))
            self._actions = actions.new_zeros((self._capacity, *actions.shape))
        self._observations[self._count % self._capacity] = observations
        self._actions[self._count % self._capacity] = actions
        self._count += 1

    def sample(
        self, counts: Sequence[int], rng: np.random.Generator
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Sample observations, actions and tasks, `counts[k]` of task k, with replacement.

        Returns:
            Observations (B, ...), actions (B,) int64 and tasks (B,) int64, where B is the sum of
            the counts.
        """
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
        """The buffer's contents."""
        return {
            "count": self._count,
            "dtype": str(self._observations.dtype).removeprefix("torch."),
            "shape": list(self._observations.shape),
            "observations": pack(self._observations),
            "actions": self._actions,
        }

    def load_state_dict(self, state: Mapping[str, Any], device: str) -> None:
        """Restore what `state_dict` returned."""
        self._count = state["count"]
        self._observations = unpack(
            state["observations"], getattr(torch, state["dtype"]), state["shape"]
        ).to(device)
        self._actions = state["actions"].to(device)


def pack(frames: Tensor) -> Tensor:
    """Compress frames, which are mostly of uniform colour."""
    packed = zlib.compress(frames.cpu().numpy().tobytes(), 1)
    return torch.frombuffer(bytearray(packed), dtype=torch.uint8)


def unpack(packed: Tensor, dtype: torch.dtype, shape: Sequence[int]) -> Tensor:
    """The inverse of `pack`, on the CPU."""
    plain = bytearray(zlib.decompress(packed.numpy().tobytes()))
    return torch.frombuffer(plain, dtype=dtype).view(*shape)
