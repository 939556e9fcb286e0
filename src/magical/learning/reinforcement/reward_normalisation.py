"""Learned rewards normalised to mean 0 and a fixed standard deviation (appendix B, Table 4)."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from magical.learning.config import NetworkSettings
from magical.learning.running.checkpoints import StateDict

FLOOR = 1e-3  # smallest standard deviation that rewards are divided by (docs/specification.md, 10)
PUBLISHED_FLOOR = 1e-5  # the published floor, 1e-3, is of the running deviation / 0.01


def reward_floor(networks: NetworkSettings) -> float:
    """The smallest standard deviation that rewards are divided by, under the conventions."""
    return PUBLISHED_FLOOR if networks.published else FLOOR


class RewardNormaliser:
    """Normalises by running statistics over all rewards of a run, separately for each task."""

    def __init__(
        self, num_tasks: int, std: float, device: str = "cpu", floor: float = FLOOR
    ) -> None:
        """Start without statistics.

        Args:
            num_tasks: the number of tasks.
            std: the standard deviation of the normalised rewards.
            device: where rewards are.
            floor: running standard deviations below this count as this.
        """
        self.target = std
        self.floor = floor
        # Double precision: sums over a million rewards.
        self.count = torch.zeros(num_tasks, dtype=torch.float64, device=device)
        self.mean = torch.zeros_like(self.count)
        self.squares = torch.zeros_like(self.count)  # summed deviations from the mean

    @property
    def std(self) -> Tensor:
        """The running standard deviation of each task's rewards, (K,)."""
        return (self.squares / self.count.clamp(min=1)).sqrt()

    def __call__(self, rewards: Tensor, tasks: Tensor) -> Tensor:
        """Update the statistics with rewards (T, N) of tasks (N,), and normalise the rewards."""
        self.update(rewards, tasks)
        divisor = self.std.clamp(min=self.floor)
        normalised = (rewards - self.mean[tasks]) / divisor[tasks] * self.target
        return normalised.to(rewards.dtype)

    def update(self, rewards: Tensor, tasks: Tensor) -> None:
        """Merge the mean and squared deviations of rewards (T, N) into the running ones."""
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

    def state_dict(self) -> StateDict:
        """The running statistics."""
        return {"count": self.count, "mean": self.mean, "squares": self.squares}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.count, self.mean, self.squares = (
            state[name].to(self.count.device) for name in ("count", "mean", "squares")
        )
