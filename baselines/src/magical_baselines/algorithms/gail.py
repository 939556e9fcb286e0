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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.optim import Adam

from magical_baselines.algorithms.ppo import (
    PUBLISHED_CODE,
    QUICK,
    PPOTrainer,
    ReinforcementConfig,
    make_policy,
)
from magical_baselines.augmentation.augment import augment, to_unit
from magical_baselines.config import (
    Algorithm,
    DemonstrationConfig,
    PositiveFloat,
    PositiveInt,
    augment_option,
    option,
)
from magical_baselines.data import ExpertData, RecentRollouts, load_demonstrations, split_evenly
from magical_baselines.models import Discriminator, Trunk, init_normal
from magical_baselines.networks import GROUP as NETWORKS
from magical_baselines.rollouts import RewardNormaliser, Rollout
from magical_baselines.training import Averages, Purpose, Run, gradient_step, seeded_init, stream

DISCRIMINATOR_INIT = 1  # number of the initialisation; the policy's is 0


@dataclass(frozen=True, kw_only=True)
class AdversarialConfig(DemonstrationConfig, ReinforcementConfig):
    """Options of algorithms with a discriminator; the defaults are Table 4's."""

    discriminator_steps: PositiveInt = option(12, "the discriminator's optimiser steps per update")
    discriminator_batch_size: PositiveInt = option(
        24, "samples per discriminator step, half of them the expert's"
    )
    discriminator_learning_rate: PositiveFloat = option(
        2.5e-5, "Adam's learning rate for the discriminator"
    )
    discriminator_network: str = option(
        "",
        "the discriminator's architecture, if not `network`",
        plugins=NETWORKS,
        known=("",),
    )
    augment: str = augment_option("all", "the discriminator's images")
    reward_std: PositiveFloat = option(0.1, "standard deviation of the normalised rewards")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_halves("discriminator_batch_size", self.discriminator_batch_size)


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


def train(config: GAILConfig, run: Run) -> None:
    """Imitate demonstrations; the reward, log D, is at most 0, and high for expert-like samples."""
    train_adversarially(config, run, gail_loss, functional.logsigmoid)


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


def train_adversarially(config: AdversarialConfig, run: Run, loss: Loss, reward: RewardFn) -> None:
    """Train policy and discriminator alternately."""
    demonstrations = load_demonstrations(config, run)
    with PPOTrainer(config, run) as ppo:
        device, compute = ppo.device, run.compute
        expert = ExpertData(demonstrations, config.tasks, config.observation_spec, device=device)
        novice = RecentRollouts(ppo.envs.task_of, device)
        discriminator = make_discriminator(config).to(device)
        optimizer = Adam(discriminator.parameters(), config.discriminator_learning_rate, fused=True)
        normaliser = RewardNormaliser(
            len(config.tasks), config.reward_std, published=config.published
        ).to(device)
        run.keep(
            discriminator=discriminator,
            discriminator_optimizer=optimizer,
            replay_buffer=novice,
            reward_statistics=normaliser,
        )
        augmentations = config.augmentations(config.augment)
        for update in ppo.remaining_updates():
            # Collect a rollout, and compute its rewards by the discriminator.
            rollout = ppo.collect_rollout(update)
            with compute.autocast():
                logits = rollout_logits(discriminator, rollout)
            # Update the policy.
            raw = reward(logits.float())
            metrics = ppo.improve_policy(update, rollout, raw, normaliser)
            # Update the discriminator.
            with ppo.monitor.timed("discriminator"):
                novice.add(rollout.observations, rollout.actions)
                rng, averages = stream(config.seed, Purpose.DISCRIMINATOR, update), Averages()
                for _ in range(config.discriminator_steps):
                    counts = split_evenly(
                        config.discriminator_batch_size // 2, len(config.tasks), rng
                    )
                    batch = sample_batch(expert, novice, counts, rng)
                    images = augment(batch.images, augmentations, rng)
                    with compute.autocast():
                        value, logged = loss(discriminator, batch._replace(images=images), rng)
                    gradient_step(optimizer, value)
                    averages.add(1, discriminator_loss=value, **logged)
                metrics |= averages.reset()
            if ppo.finish_update(update, metrics):
                break


def rollout_logits(discriminator: Discriminator, rollout: Rollout) -> Tensor:
    """Logits (T, N) of a rollout, with batch norm in evaluation mode.

    On a CPU, they are computed step by step, which takes less memory.
    """
    steps, envs = rollout.actions.shape
    tasks = rollout.tasks.repeat(steps)
    samples = rollout.observations.flatten(0, 1), rollout.actions.flatten(), tasks
    size = envs if tasks.device.type == "cpu" else steps * envs
    chunks = zip(*(torch.split(part, size) for part in samples), strict=True)
    discriminator.eval()
    with torch.no_grad():
        logits = [discriminator(to_unit(images), *others) for images, *others in chunks]
    discriminator.train()
    return torch.cat(logits).view(steps, envs)


def sample_batch(
    expert: ExpertData, novice: RecentRollouts, counts: Sequence[int], rng: np.random.Generator
) -> DiscriminatorBatch:
    """Sample `counts[k]` samples of task k from both, as stored."""
    rows = expert.sample_counts(counts, rng)
    novice_images, *novice_labels = novice.sample(counts, rng)
    images = torch.cat([expert.images(rows), novice_images])
    pairs = zip(expert.labels(rows), novice_labels, strict=True)
    actions, tasks = (torch.cat(pair) for pair in pairs)
    return DiscriminatorBatch(images, actions, tasks)


def make_discriminator(config: AdversarialConfig) -> Discriminator:
    """The discriminator, with batch norm and action input, initialised from the seed.

    In the published code, the last layer of a multi-task run has a table row for each task,
    initialised from N(0, 1); with one task it is a plain linear layer.
    """
    with seeded_init(config.seed, DISCRIMINATOR_INIT):
        trunk = Trunk(
            config.discriminator_network or config.network,
            config.input_shape,
            batch_norm=True,
            action_input=config.action_input,
            pixel_range=config.pixel_range,
        )
        discriminator = Discriminator(trunk, len(config.tasks))
        if config.published and len(config.tasks) > 1:
            init_normal(discriminator.last)
        return discriminator


ALGORITHM = Algorithm(GAILConfig, train, make_policy)
