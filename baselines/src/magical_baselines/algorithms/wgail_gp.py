"""Wasserstein GAIL with a gradient penalty.

Source: appendix B, Table 4, and C; docs/specification.md, section 10. Single-task only.

Like GAIL, but the discriminator is a critic f without a sigmoid: it maximises the difference of its
mean logits on expert and novice samples, an estimate of the Wasserstein distance. A penalty on the
gradient keeps it nearly 1-Lipschitz in the image. The reward is the logit itself.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from magical_baselines.algorithms.gail import (
    AdversarialConfig,
    DiscriminatorBatch,
    GAILConfig,
    train_adversarially,
)
from magical_baselines.algorithms.ppo import make_policy
from magical_baselines.config import Algorithm, PositiveFloat, option
from magical_baselines.models import Discriminator
from magical_baselines.training import Run

Critic = Callable[[Tensor, Tensor, Tensor], Tensor]  # images, actions, tasks -> logits (B,)


@dataclass(frozen=True, kw_only=True)
class WGAILGPConfig(AdversarialConfig):
    """Settings of Wasserstein GAIL with a gradient penalty; the defaults are Table 4's."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        **GAILConfig.presets,
        "published-code": {
            **GAILConfig.presets["published-code"],
            "penalty_weight": 200.0,  # published: 100, with half the difference of the means
        },
    }

    algorithm: str = "wgail-gp"
    penalty_weight: PositiveFloat = option(100.0, "lambda: weight of the gradient penalty")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_one_task()


def train(config: WGAILGPConfig, run: Run) -> None:
    """Imitate demonstrations; the reward is the logit itself."""

    def loss(critic: Discriminator, batch: DiscriminatorBatch, rng: np.random.Generator) -> Any:
        return critic_loss(critic, batch, rng, config.penalty_weight, config.published)

    train_adversarially(config, run, loss, lambda logits: logits)


def critic_loss(
    critic: Discriminator,
    batch: DiscriminatorBatch,
    rng: np.random.Generator,
    penalty_weight: float,
    penalty_batch_norm: bool = False,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Mean f(novice) - mean f(expert) + penalty_weight * penalty: to be minimised.

    Batch norm is in evaluation mode for the penalty: the function that gives the rewards has to be
    Lipschitz, a row's gradient must not depend on other rows, and the statistics must remain those
    of real images. With `penalty_batch_norm` it is in training mode, as in the published code.

    Logs the estimated distance, mean f(expert) - mean f(novice); the penalty; and the accuracy of a
    threshold midway between the two means.
    """
    logits = critic(batch.images, batch.actions, batch.tasks).float()  # (2B,)
    expert, novice = logits.chunk(2)
    distance = expert.mean() - novice.mean()
    critic.train(penalty_batch_norm)
    penalty = gradient_penalty(critic, *interpolate(batch, rng), critic.trunk.pixels)
    critic.train()
    threshold = (expert.mean() + novice.mean()) / 2
    accuracy = torch.cat([expert > threshold, novice < threshold]).float().mean()
    return penalty_weight * penalty - distance, {
        "wasserstein_distance": distance,
        "gradient_penalty": penalty,
        "discriminator_accuracy": accuracy,
    }


def interpolate(
    batch: DiscriminatorBatch, rng: np.random.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Sample points uniformly between pairs of an expert and a novice image.

    Returns:
        Images (B, C, H, W), actions (B,) of the nearer image, tasks (B,).
    """
    expert, novice = batch.images.chunk(2)
    expert_actions, novice_actions = batch.actions.chunk(2)
    uniforms = rng.random(len(expert), np.float32)
    weight = torch.from_numpy(uniforms).to(expert.device)  # of the expert's image
    images = torch.lerp(novice, expert, weight[:, None, None, None])
    actions = torch.where(weight > 0.5, expert_actions, novice_actions)
    return images, actions, batch.tasks[: len(expert)]


def gradient_penalty(
    critic: Critic,
    images: Tensor,
    actions: Tensor,
    tasks: Tensor,
    pixels: tuple[float, float] = (0.0, 1.0),
) -> Tensor:
    """Mean of (|df / d image|_2 - 1)^2; differentiable with respect to the critic's weights.

    Images (B, C, H, W) are in [0, 1]; the gradient is with respect to pixels scaled to the range
    from `pixels[0]` to `pixels[1]`, which is the input of the critic's first convolution.
    """
    images = images.detach().requires_grad_()
    logits = critic(images, actions, tasks)
    (gradients,) = torch.autograd.grad(logits.sum(), images, create_graph=True)
    low, high = pixels
    norms: Tensor = torch.linalg.vector_norm(gradients.float().flatten(1), dim=1)  # (B,)
    norms = norms / (high - low)
    return (norms - 1.0).square().mean()


ALGORITHM = Algorithm(WGAILGPConfig, train, make_policy)
