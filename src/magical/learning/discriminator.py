"""The other side of adversarial imitation: a discriminator, what it learns from, its rewards."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.optim import Adam

from magical.learning.augment import augment, parse_augmentations
from magical.learning.checkpoints import Tree, load_module, load_optimizer, optimizer_tree
from magical.learning.devices import Compute
from magical.learning.expert_data import ExpertData
from magical.learning.networks import Discriminator
from magical.learning.replay import Replay
from magical.learning.reward_normalisation import RewardNormaliser
from magical.learning.rollout import Samples, as_inputs

Metrics = dict[str, float | str]


class Pairs(NamedTuple):
    """A discriminator's batch: B rows of the expert, then B of the novice."""

    images: Tensor  # (2B, C, H, W) float32 in [0, 1]
    actions: Tensor  # (2B,) int64
    tasks: Tensor  # (2B,) int64

    @property
    def half(self) -> int:
        """B."""
        return len(self.images) // 2


# Network, batch, source of random numbers -> loss to be minimised, and what is reported.
Loss = Callable[[Discriminator, Pairs, np.random.Generator], tuple[Tensor, dict[str, Tensor]]]
ToReward = Callable[[Tensor], Tensor]


class Rival:
    """A discriminator that is trained to tell the expert from the novice."""

    def __init__(
        self,
        network: Discriminator,
        expert: ExpertData,
        replay: Replay,
        normaliser: RewardNormaliser,
        *,
        loss: Loss,
        to_reward: ToReward,
        learning_rate: float,
        augmentations: str,
        compute: Compute,
    ) -> None:
        self.network = network
        self.optimizer = Adam(network.parameters(), learning_rate, fused=True)
        self._expert = expert
        self._replay = replay
        self._normaliser = normaliser
        self._loss = loss
        self._to_reward = to_reward
        self._augmentations = parse_augmentations(augmentations)
        self._compute = compute

    def rewards(self, samples: Samples) -> tuple[Tensor, Metrics]:
        """Normalised rewards (T, N), by the discriminator as it is; and its raw ones' statistics.

        Batch norm is in evaluation mode.
        """
        self.network.eval()
        with torch.no_grad(), self._compute.autocast():
            logits = [
                self.network(as_inputs(shown), actions, samples.tasks)
                for shown, actions in zip(samples.observations, samples.actions, strict=True)
            ]
        self.network.train()
        raw = self._to_reward(torch.cat(logits).float()).view_as(samples.rewards)
        statistics: Metrics = {
            "raw_reward": raw.mean().item(),
            "raw_reward_std": raw.std(correction=0).item(),
        }
        return self._normaliser(raw, samples.tasks), statistics

    def remember(self, samples: Samples) -> None:
        """Keep what the novice has just done."""
        self._replay.add(samples.observations, samples.actions)

    def learn(self, steps: int, batch_size: int, rng: np.random.Generator) -> Metrics:
        """Steps of the optimiser; returns the means of what is reported."""
        sums: dict[str, Tensor] = {}
        for _ in range(steps):
            pairs = self.draw(batch_size // 2, rng)
            with self._compute.autocast():
                loss, report = self._loss(self.network, pairs, rng)
            self.optimizer.zero_grad()
            torch.autograd.backward(loss)
            self.optimizer.step()
            for name, value in {"discriminator_loss": loss, **report}.items():
                sums[name] = sums.get(name, torch.zeros_like(loss)) + value.detach()
        return {name: (total / steps).item() for name, total in sums.items()}

    def draw(self, half: int, rng: np.random.Generator) -> Pairs:
        """A batch, both halves split evenly between the tasks and augmented."""
        rows = self._expert.sample_evenly(half, rng)
        actions, tasks = self._expert.labels(rows)
        shown, novice_actions, novice_tasks = self._replay.sample_evenly(half, rng)
        images = torch.cat([self._expert.images(rows), shown])
        return Pairs(
            augment(images, self._augmentations, rng),
            torch.cat([actions, novice_actions]),
            torch.cat([tasks, novice_tasks]),
        )

    def tree(self) -> Tree:
        """For a checkpoint."""
        return {
            "discriminator": self.network.state_dict(),
            "discriminator_optimizer": optimizer_tree(self.optimizer),
            "replay": self._replay.tree(),
            "reward_statistics": self._normaliser.tree(),
        }

    def load(self, tree: Mapping[str, Any], what: str) -> None:
        """Continue from what `tree` returned."""
        load_module(self.network, tree["discriminator"], what)
        load_optimizer(self.optimizer, tree["discriminator_optimizer"])
        self._replay.load(tree["replay"], self._compute.device)
        self._normaliser.load(tree["reward_statistics"])
