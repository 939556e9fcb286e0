"""Learned rewards kept at mean 0 and a fixed standard deviation (appendix B, Table 4)."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from magical.learning.checkpoints import Tree

SMALLEST_DIVISOR = 1e-3  # docs/specification.md, section 10


class RewardNormaliser:
    """Running mean and variance over a run's whole history, for each task its own."""

    def __init__(self, num_tasks: int, std: float, device: str = "cpu") -> None:
        """`std` is what the rewards' standard deviation is brought to."""
        self.target = std
        # Double precision: a million rewards are summed up.
        self.count = torch.zeros(num_tasks, dtype=torch.float64, device=device)
        self.mean = torch.zeros_like(self.count)
        self.squares = torch.zeros_like(self.count)  # summed deviations from the mean

    @property
    def std(self) -> Tensor:
        """The running standard deviation of each task's rewards, (K,)."""
        return (self.squares / self.count.clamp(min=1)).sqrt()

    def __call__(self, rewards: Tensor, tasks: Tensor) -> Tensor:
        """Take rewards (T, N) of worlds' tasks (N,) into account and return them normalised."""
        self.update(rewards, tasks)
        divisor = self.std.clamp(min=SMALLEST_DIVISOR)
        normalised = (rewards - self.mean[tasks]) / divisor[tasks] * self.target
        return normalised.to(rewards.dtype)

    def update(self, rewards: Tensor, tasks: Tensor) -> None:
        """Merge a batch's own mean and squared deviations into the running ones."""
        rewards = rewards.double()
        member = torch.nn.functional.one_hot(tasks, len(self.count)).double()  # (N, K)
        count = len(rewards) * member.sum(dim=0)
        mean = rewards.sum(dim=0) @ member / count.clamp(min=1)
        squares = (rewards - mean[tasks]).square().sum(dim=0) @ member
        total = (self.count + count).clamp(min=1)
        change = mean - self.mean
        self.squares += squares + change.square() * self.count * count / total
        self.mean += change * count / total
        self.count += count

    def tree(self) -> Tree:
        """For a checkpoint."""
        return {"count": self.count, "mean": self.mean, "squares": self.squares}

    def load(self, tree: Mapping[str, Any]) -> None:
        """Continue from what `tree` returned."""
        self.count, self.mean, self.squares = (
            tree[name].to(self.count.device) for name in ("count", "mean", "squares")
        )
