"""Generative adversarial imitation learning (Ho and Ermon, 2016).

Source: appendix B, Table 4; docs/specification.md, section 10. Single- and multi-task.

A discriminator D is trained to tell the expert's observations and actions from the novice's; PPO
maximises the reward log D(s, a). One iteration:

1. collect a rollout with the current policy (the novice);
2. compute its rewards with the current discriminator, normalised by running statistics;
3. update the policy by PPO with these rewards;
4. add the rollout to the replay buffer;
5. take some optimiser steps on the discriminator's loss, with one half of each batch sampled from
   the demonstrations and the other from the replay buffer.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.optim import Adam

from magical_baselines.algorithms import Algorithm
from magical_baselines.algorithms.ppo import (
    PUBLISHED_CODE,
    QUICK,
    PPOTrainer,
    ReinforcementConfig,
    make_policy,
)
from magical_baselines.augmentation.augment import augment, to_unit
from magical_baselines.augmentation.names import augment_option
from magical_baselines.config import DemonstrationSettings
from magical_baselines.data.expert_data import ExpertData, load_demonstrations, split_evenly
from magical_baselines.models import Discriminator, Trunk, init_normal
from magical_baselines.reinforcement.monitoring import Metrics
from magical_baselines.reinforcement.replay_buffer import ROLLOUTS, ReplayBuffer
from magical_baselines.reinforcement.reward_normalisation import RewardNormaliser, reward_floor
from magical_baselines.reinforcement.rollouts import Rollout
from magical_baselines.running.averages import Averages
from magical_baselines.running.checkpoints import StateDict, restoring
from magical_baselines.running.devices import Compute
from magical_baselines.running.optimizers import load_optimizer, optimizer_state
from magical_baselines.running.run import Run
from magical_baselines.running.streams import Purpose, seeded_init, stream
from magical_baselines.settings import POSITIVE, Settings, option

DISCRIMINATOR_INIT = 1  # number of the initialisation; the policy's is 0


@dataclass(frozen=True, kw_only=True)
class DiscriminatorSettings(Settings):
    """How a discriminator is trained and its rewards are normalised; the defaults are Table 4's."""

    steps: int = option(
        12, "the discriminator's optimiser steps per update", POSITIVE, name="discriminator_steps"
    )
    batch_size: int = option(
        24,
        "samples per discriminator step, half of them the expert's",
        name="discriminator_batch_size",
    )
    learning_rate: float = option(
        2.5e-5,
        "Adam's learning rate for the discriminator",
        POSITIVE,
        name="discriminator_learning_rate",
    )
    augment: str = augment_option("all", "the discriminator's images")
    reward_std: float = option(0.1, "standard deviation of the normalised rewards", POSITIVE)


@dataclass(frozen=True, kw_only=True)
class AdversarialConfig(ReinforcementConfig):
    """Base of the configurations of algorithms with a discriminator."""

    demonstrations: DemonstrationSettings
    discriminator: DiscriminatorSettings = field(default_factory=DiscriminatorSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_halves("discriminator_batch_size", self.discriminator.batch_size)

    @property
    def discriminator_samples(self) -> int:
        """The samples of all batches of the discriminator."""
        return self.num_updates * self.discriminator.steps * self.discriminator.batch_size

    @property
    def training_samples(self) -> int:
        """The samples of the policy and of the discriminator."""
        return super().training_samples + self.discriminator_samples


@dataclass(frozen=True, kw_only=True)
class GAILConfig(AdversarialConfig):
    """Settings of generative adversarial imitation learning; the defaults are Table 4's."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {
            **QUICK,
            "discriminator_learning_rate": 1e-4,
            "augment": "noise+translation+rotation",
        },
        "published-code": {**PUBLISHED_CODE, "discriminator_learning_rate": 2e-5},
    }

    algorithm: str = "gail"


def train(config: GAILConfig, run: Run) -> None:
    """Imitate demonstrations."""
    train_adversarially(config, run, gail_loss, gail_reward)


class DiscriminatorBatch(NamedTuple):
    """B samples from the expert, followed by B from the novice."""

    images: Tensor  # (2B, C, H, W), as stored, or float32 in [0, 1]
    actions: Tensor  # (2B,) int64
    tasks: Tensor  # (2B,) int64


# Discriminator, batch, random numbers -> the loss to be minimised, and other values to log.
Loss = Callable[
    [Discriminator, DiscriminatorBatch, np.random.Generator], tuple[Tensor, dict[str, Tensor]]
]
RewardFn = Callable[[Tensor], Tensor]  # logits -> rewards of the same shape


def gail_loss(
    discriminator: Discriminator, batch: DiscriminatorBatch, rng: np.random.Generator
) -> tuple[Tensor, dict[str, Tensor]]:
    """Mean binary cross-entropy of the logits (expert 1, novice 0): to be minimised."""
    logits = discriminator(batch.images, batch.actions, batch.tasks).float()  # (2B,)
    labels = torch.zeros_like(logits)
    labels[: len(labels) // 2] = 1.0
    loss = functional.binary_cross_entropy_with_logits(logits, labels)
    accuracy = ((logits > 0) == (labels > 0)).float().mean()
    return loss, {"discriminator_accuracy": accuracy}


def gail_reward(logits: Tensor) -> Tensor:
    """The log-sigmoid of the logits, log D: at most 0, and high for expert-like samples."""
    return functional.logsigmoid(logits)


def train_adversarially(config: AdversarialConfig, run: Run, loss: Loss, reward: RewardFn) -> None:
    """Train policy and discriminator alternately."""
    demonstrations = load_demonstrations(config, run)
    with PPOTrainer(config, run) as ppo:
        expert = ExpertData(
            demonstrations, config.tasks, config.observation_spec, device=ppo.device
        )
        replay_buffer = ReplayBuffer(ROLLOUTS, ppo.envs.task_of)
        discriminator = DiscriminatorTrainer(
            config, expert, replay_buffer, ppo.compute, loss, reward
        )
        if run.saved:
            with restoring(run.folder):
                discriminator.load_state_dict(run.saved["discriminator"])
        for update in ppo.remaining_updates():
            rollout = ppo.collect_rollout(update)
            rewards, metrics = discriminator.rewards(rollout)
            metrics |= ppo.improve_policy(update, rollout, rewards)
            with ppo.monitor.timed("discriminator"):
                replay_buffer.add(rollout.observations, rollout.actions)
                metrics |= discriminator.train(stream(config.seed, Purpose.DISCRIMINATOR, update))
            if ppo.finish_update(
                update, metrics, lambda: {"discriminator": discriminator.state_dict()}
            ):
                break


class DiscriminatorTrainer:
    """A discriminator, its optimiser, and the two sources of its batches."""

    def __init__(
        self,
        config: AdversarialConfig,
        expert: ExpertData,
        replay_buffer: ReplayBuffer,
        compute: Compute,
        loss: Loss,
        reward: RewardFn,
    ) -> None:
        self.config = config
        self.network = make_discriminator(config).to(compute.device)
        rate = config.discriminator.learning_rate
        self.optimizer = Adam(self.network.parameters(), rate, fused=True)
        self._expert = expert
        self._replay_buffer = replay_buffer
        self._normaliser = RewardNormaliser(
            len(config.tasks), config.discriminator.reward_std, reward_floor(config.networks)
        ).to(compute.device)
        self._augmentations = config.networks.augmentations(config.discriminator.augment)
        self._compute = compute
        self._loss = loss
        self._reward = reward

    def rewards(self, rollout: Rollout) -> tuple[Tensor, Metrics]:
        """Normalised rewards (T, N) of a rollout, and raw rewards' mean and standard deviation.

        Batch norm is in evaluation mode.
        """
        self.network.eval()
        steps, envs = rollout.actions.shape
        chunk = envs if self._compute.device == "cpu" else steps * envs
        tasks = rollout.tasks.repeat(steps)
        samples = rollout.observations.flatten(0, 1), rollout.actions.flatten(), tasks
        chunks = zip(*(torch.split(part, chunk) for part in samples), strict=True)
        with torch.no_grad(), self._compute.autocast():
            logits = [
                self.network(to_unit(images), actions, numbers)
                for images, actions, numbers in chunks
            ]
        self.network.train()
        raw = self._reward(torch.cat(logits).float()).view(steps, envs)
        metrics: Metrics = {
            "raw_reward": raw.mean().item(),
            "raw_reward_std": raw.std(correction=0).item(),
        }
        return self._normaliser(raw, rollout.tasks), metrics

    def train(self, rng: np.random.Generator) -> Metrics:
        """Take an update's optimiser steps; returns the means of the logged values."""
        averages = Averages()
        for _ in range(self.config.discriminator.steps):
            averages.add(1, **self._step(self.sample_batch(rng), rng))
        return {**averages.reset()}

    def _step(self, batch: DiscriminatorBatch, rng: np.random.Generator) -> dict[str, Tensor]:
        """Take one optimiser step on a batch; returns the values to log."""
        images = augment(batch.images, self._augmentations, rng)
        with self._compute.autocast():
            loss, logged = self._loss(self.network, batch._replace(images=images), rng)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        self.optimizer.step()
        return {"discriminator_loss": loss, **logged}

    def sample_batch(self, rng: np.random.Generator) -> DiscriminatorBatch:
        """Sample a batch as stored; both halves are split between the tasks in the same way."""
        half = self.config.discriminator.batch_size // 2
        counts = split_evenly(half, len(self.config.tasks), rng)
        rows = self._expert.sample_counts(counts, rng)
        expert_actions, expert_tasks = self._expert.labels(rows)
        novice_images, novice_actions, novice_tasks = self._replay_buffer.sample(counts, rng)
        return DiscriminatorBatch(
            torch.cat([self._expert.images(rows), novice_images]),
            torch.cat([expert_actions, novice_actions]),
            torch.cat([expert_tasks, novice_tasks]),
        )

    def state_dict(self) -> StateDict:
        """Everything that the next update depends on."""
        return {
            "network": self.network.state_dict(),
            "optimizer": optimizer_state(self.optimizer),
            "replay_buffer": self._replay_buffer.state_dict(),
            "reward_statistics": self._normaliser.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.network.load_state_dict(state["network"])
        load_optimizer(self.optimizer, state["optimizer"])
        self._replay_buffer.load_state_dict(state["replay_buffer"], self._compute.device)
        self._normaliser.load_state_dict(state["reward_statistics"])


def make_discriminator(config: AdversarialConfig) -> Discriminator:
    """The discriminator, with batch norm and action input, initialised from the seed.

    In the published code, the last layer of a multi-task run has a table row for each task,
    initialised from N(0, 1); with one task it is a plain linear layer.
    """
    networks = config.networks
    with seeded_init(config.seed, DISCRIMINATOR_INIT):
        trunk = Trunk(
            networks.network,
            config.input_shape,
            batch_norm=True,
            action_input=networks.action_input,
            pixel_range=networks.pixel_range,
        )
        discriminator = Discriminator(trunk, len(config.tasks))
        if networks.published and len(config.tasks) > 1:
            init_normal(discriminator.last)
        return discriminator


ALGORITHM = Algorithm(GAILConfig, train, make_policy)
