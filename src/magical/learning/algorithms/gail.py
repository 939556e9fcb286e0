"""Generative adversarial imitation learning.

Source: appendix B, Table 4; docs/specification.md, section 10.

The discriminator learns to tell the expert's observations and actions from the novice's; PPO
learns to be taken for the expert. Single- and multi-task.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from magical.errors import InvalidConfigError
from magical.learning.algorithms import Algorithm
from magical.learning.algorithms.ppo import Learner, make_policy
from magical.learning.config import ImitationConfig, option
from magical.learning.discriminator import Loss, Pairs, Rival, ToReward
from magical.learning.expert_data import ExpertData, choose_demonstrations
from magical.learning.networks import Discriminator, get_width
from magical.learning.reinforcement import QUICK, ReinforcementConfig
from magical.learning.replay import Replay
from magical.learning.reward_normalisation import RewardNormaliser
from magical.learning.runs import Run
from magical.learning.streams import Purpose, seeded_weights, stream

WEIGHTS_NUMBER = 1  # the policy's first weights are number 0 of the seed


@dataclass(frozen=True, kw_only=True)
class GAILConfig(ReinforcementConfig, ImitationConfig):
    """Settings of generative adversarial imitation learning; the defaults are Table 4's."""

    algorithm: ClassVar[str] = "gail"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {
            **QUICK,
            "discriminator_learning_rate": 1e-4,
            "augment": "noise+translation+rotation",
        },
    }

    discriminator_steps: int = option(12, "the discriminator's steps in an update")
    discriminator_batch_size: int = option(24, "samples in such a step, half of them expert's")
    discriminator_learning_rate: float = option(2.5e-5, "Adam's step size for the discriminator")
    augment: str = option(
        "all", "of the discriminator's images: all, none, no-trans-rot, or names joined by +"
    )
    reward_std: float = option(0.1, "standard deviation that rewards are normalised to")
    replay_batches: int = option(4, "sampler batches that novice samples are drawn from")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("discriminator_steps", "discriminator_learning_rate")
        self.require_positive("reward_std", "replay_batches")
        self.require_augmentations("augment")
        least = 2 * len(self.tasks)
        if self.discriminator_batch_size < least or self.discriminator_batch_size % 2:
            raise InvalidConfigError(
                "discriminator_batch_size: expected an even number, at least two for each task, "
                f"found {self.discriminator_batch_size}"
            )


def train(config: GAILConfig, run: Run) -> None:
    """Imitate demonstrations."""
    train_against(config, run, discriminator_loss, functional.logsigmoid)


def train_against(config: GAILConfig, run: Run, loss: Loss, to_reward: ToReward) -> None:
    """Let a policy and a discriminator with this loss and reward learn in turns.

    In each update the policy is improved with the discriminator as it is, which then learns.
    """
    chosen = choose_demonstrations(config.demos, config.tasks, config.num_demos, config.seed)
    run.describe(demonstrations=list(chosen.record))
    with Learner(config, run) as learner:
        expert = ExpertData(
            chosen.trajectories, config.tasks, config.observation_spec, device=learner.device
        )
        rival = Rival(
            make_discriminator(config).to(learner.device),
            expert,
            Replay(config.replay_batches, learner.sampler.task_of),
            RewardNormaliser(len(config.tasks), config.reward_std, learner.device),
            loss=loss,
            to_reward=to_reward,
            learning_rate=config.discriminator_learning_rate,
            augmentations=config.augment,
            compute=learner.compute,
        )
        if run.saved:
            rival.load(run.saved["rival"], str(run.folder))

        for number in learner.numbers():
            samples = learner.collect(number)
            rewards, statistics = rival.rewards(samples)
            metrics = learner.improve(number, samples, rewards)

            began = time.perf_counter()
            rival.remember(samples)
            rng = stream(config.seed, Purpose.DISCRIMINATOR, number)
            metrics |= statistics
            metrics |= rival.learn(config.discriminator_steps, config.discriminator_batch_size, rng)
            took = time.perf_counter() - began
            tree = lambda: {"rival": rival.tree()}  # noqa: E731
            if learner.finish(number, metrics, tree, discriminator=took):
                break


def discriminator_loss(
    network: Discriminator, pairs: Pairs, rng: np.random.Generator
) -> tuple[Tensor, dict[str, Tensor]]:
    """Mean binary cross-entropy with the expert's rows labelled 1: to be minimised.

    Also reports the accuracy.
    """
    logits = network(pairs.images, pairs.actions, pairs.tasks).float()  # (2B,)
    labels = torch.zeros_like(logits)
    labels[: pairs.half] = 1.0
    loss = functional.binary_cross_entropy_with_logits(logits, labels)
    accuracy = ((logits > 0) == (labels > 0)).float().mean()
    return loss, {"discriminator_accuracy": accuracy}


def make_discriminator(config: GAILConfig) -> Discriminator:
    """The network with batch norm and action input, with first weights from the seed."""
    with seeded_weights(config.seed, WEIGHTS_NUMBER):
        return Discriminator(get_width(config.network), config.input_shape, len(config.tasks))


ALGORITHM = Algorithm(GAILConfig, train, make_policy)
