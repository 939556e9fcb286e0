"""Rollouts as samples with advantages and value targets."""

from typing import NamedTuple

import torch
from torch import Tensor

from magical.learning.augmentation.augment import to_unit
from magical.learning.reinforcement.rollouts import Rollout

ADVANTAGE_EPSILON = 1e-8


class Samples(NamedTuple):
    """The samples of a rollout, B = T * N, or a minibatch of them."""

    observations: Tensor  # (B, ...) network inputs
    actions: Tensor  # (B,) int64
    log_probs: Tensor  # (B,), of the actions under the policy that collected them
    advantages: Tensor  # (B,)
    returns: Tensor  # (B,), the value targets
    tasks: Tensor  # (B,) int64

    def select(self, rows: Tensor) -> "Samples":
        """A minibatch."""
        return Samples(*(part[rows] for part in self))


def make_samples(
    rollout: Rollout, rewards: Tensor, gamma: float, gae_lambda: float, normalise: bool
) -> Samples:
    """Flatten a rollout, time-major, with the advantages and value targets of rewards (T, N)."""
    advantages = compute_gae(rollout, rewards, gamma, gae_lambda)
    returns = advantages + rollout.values
    if normalise:
        advantages = (advantages - advantages.mean()) / (advantages.std() + ADVANTAGE_EPSILON)
    return Samples(
        to_unit(rollout.observations.flatten(0, 1)),
        rollout.actions.flatten(),
        rollout.log_probs.flatten(),
        advantages.flatten(),
        returns.flatten(),
        rollout.tasks.repeat(len(rewards)),
    )


def compute_gae(rollout: Rollout, rewards: Tensor, gamma: float, gae_lambda: float) -> Tensor:
    """Generalised advantage estimates (T, N) for rewards (T, N).

    A_t = delta_t + gamma * lambda * (1 - done_t) * A_{t+1}, where
    delta_t = r_t + gamma * V(s_{t+1}) - V(s_t). At the end of an episode V(s_{t+1}) is 0 or the
    value of the final observation: `Rollout.next_values` already contains the choice.
    """
    deltas = rewards + gamma * rollout.next_values - rollout.values
    weights = gamma * gae_lambda * ~rollout.dones
    advantages = torch.empty_like(deltas)
    following = torch.zeros_like(deltas[0])
    for t in reversed(range(len(deltas))):
        following = deltas[t] + weights[t] * following
        advantages[t] = following
    return advantages
