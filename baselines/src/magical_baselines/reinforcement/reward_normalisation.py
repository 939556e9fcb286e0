"""Normalising learned rewards to mean 0 and a fixed standard deviation (appendix B, Table 4)."""

import torch
from torch import Tensor, nn

from magical_baselines.config import NetworkSettings

FLOOR = 1e-3  # smallest standard deviation that rewards are divided by (docs/specification.md, 10)
PUBLISHED_FLOOR = 1e-5  # the published floor, 1e-3, applies to the running deviation / 0.01


def reward_floor(networks: NetworkSettings) -> float:
    """The smallest standard deviation that rewards are divided by, under the conventions."""
    return PUBLISHED_FLOOR if networks.published else FLOOR


class RewardNormaliser(nn.Module):
    """Normalises rewards by running statistics over the whole run, separately for each task."""

    # One number per task, (K,), in double precision, as they sum over a million rewards.
    count: Tensor
    mean: Tensor
    squares: Tensor  # sums of squared deviations from the mean

    def __init__(self, num_tasks: int, std: float, floor: float = FLOOR) -> None:
        """Start without statistics.

        Args:
            num_tasks: the number of tasks.
            std: the standard deviation of the normalised rewards.
            floor: the smallest standard deviation that rewards are divided by.
        """
        super().__init__()
        self.target = std
        self.floor = floor
        for name in ("count", "mean", "squares"):
            self.register_buffer(name, torch.zeros(num_tasks, dtype=torch.float64))

    def forward(self, rewards: Tensor, tasks: Tensor) -> Tensor:
        """Update the statistics with rewards (T, N) of tasks (N,), and normalise the rewards."""
        self.update(rewards, tasks)
        std = (self.squares / self.count.clamp(min=1)).sqrt().clamp(min=self.floor)  # (K,)
        normalised = (rewards - self.mean[tasks]) / std[tasks] * self.target
        return normalised.to(rewards.dtype)

    def update(self, rewards: Tensor, tasks: Tensor) -> None:
        """Merge the mean and squared deviations of rewards (T, N) into the running ones."""
        rewards = rewards.double()
        member = nn.functional.one_hot(tasks, len(self.count)).double()  # (N, K)
        count = len(rewards) * member.sum(dim=0)
        mean = rewards.sum(dim=0) @ member / count.clamp(min=1)
        squares = (rewards - mean[tasks]).square().sum(dim=0) @ member
        total = (self.count + count).clamp(min=1)
        change = mean - self.mean
        self.squares += squares + change.square() * self.count * count / total
        self.mean += change * count / total
        self.count += count
