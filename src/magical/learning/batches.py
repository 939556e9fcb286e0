"""From samples to what PPO learns from: advantages, returns, minibatches."""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.learning.reinforcement import ReinforcementConfig
from magical.learning.rollout import Samples, as_inputs


class Batch(NamedTuple):
    """Samples of an update, B in all or some of them."""

    inputs: Tensor  # (B, ...), observations ready for the network
    actions: Tensor  # (B,) int64
    log_probs: Tensor  # (B,), when the actions were chosen
    advantages: Tensor  # (B,)
    returns: Tensor  # (B,), what values are drawn to
    tasks: Tensor  # (B,) int64

    def rows(self, rows: Tensor) -> "Batch":
        """Some of the samples."""
        return Batch(*(part[rows] for part in self))


def as_batch(samples: Samples, rewards: Tensor, config: ReinforcementConfig) -> Batch:
    """One row a sample, time by time, valued with rewards (T, N).

    Observations are made ready for the network once, not in every epoch.
    """
    advantages = generalised_advantages(
        rewards,
        samples.values,
        samples.next_values,
        samples.ended,
        config.discount,
        config.gae_lambda,
    )
    returns = (advantages + samples.values).flatten()
    if config.normalise_advantages:
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    return Batch(
        as_inputs(samples.observations.flatten(0, 1)),
        samples.actions.flatten(),
        samples.log_probs.flatten(),
        advantages.flatten(),
        returns,
        samples.tasks.repeat(len(rewards)),
    )


def generalised_advantages(
    rewards: Tensor,
    values: Tensor,
    next_values: Tensor,
    ended: Tensor,
    discount: float,
    gae_lambda: float,
) -> Tensor:
    """Generalised advantage estimates (T, N); all arguments have that shape.

    Nothing flows back over an episode's end. Whether it is bootstrapped has been decided in
    `next_values`: 0 there, or the value of the last observation.
    """
    errors = rewards + discount * next_values - values
    carried = discount * gae_lambda * ~ended
    advantages = torch.empty_like(errors)
    following = torch.zeros_like(errors[0])
    for t in reversed(range(len(errors))):
        following = errors[t] + carried[t] * following
        advantages[t] = following
    return advantages


def spread(tasks: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """A random order of rows of tasks (B,) whose every stretch is split evenly between them."""
    places = np.empty(len(tasks))
    for task in np.unique(tasks):
        rows = rng.permutation(np.flatnonzero(tasks == task))
        places[rows] = (np.arange(len(rows)) + 0.5) / len(rows)
    return np.argsort(places, kind="stable")


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """How much of the returns' variance the values explain, at most 1; 0 without variance."""
    variance = returns.var(correction=0)
    left = (returns - values).var(correction=0)
    return (1.0 - left / variance).item() if variance > 0 else 0.0


def mean_by_task(scores: Collection[tuple[int, float]]) -> float:
    """The mean over tasks of the mean score of each."""
    tasks = {task for task, _ in scores}
    means = [np.mean([score for t, score in scores if t == task]) for task in tasks]
    return float(np.mean(means))
