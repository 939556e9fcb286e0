"""Wasserstein GAIL with a gradient penalty.

Source: appendix B, Table 4, and C; docs/specification.md, section 10.

The discriminator is a critic without a last sigmoid: its logit is the reward, and a penalty keeps
it nearly 1-Lipschitz in the image. Everything else is as in GAIL. Single-task only.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from magical.learning.algorithms import Algorithm
from magical.learning.algorithms.gail import GAILConfig, train_against
from magical.learning.algorithms.ppo import make_policy
from magical.learning.config import option
from magical.learning.discriminator import Pairs
from magical.learning.networks import Discriminator
from magical.learning.runs import Run

Critic = Callable[[Tensor, Tensor, Tensor], Tensor]  # images, actions, tasks -> logits (B,)


@dataclass(frozen=True, kw_only=True)
class WGAILGPConfig(GAILConfig):
    """Settings of Wasserstein GAIL with a gradient penalty; the defaults are Table 4's."""

    algorithm: ClassVar[str] = "wgail-gp"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = GAILConfig.presets

    penalty_weight: float = option(100.0, "weight of the gradient penalty")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("penalty_weight")
        self.require_one_task()


def train(config: WGAILGPConfig, run: Run) -> None:
    """Imitate demonstrations."""
    loss = partial(critic_loss, weight=config.penalty_weight)
    train_against(config, run, loss, lambda logits: logits)


def critic_loss(
    network: Discriminator, pairs: Pairs, rng: np.random.Generator, weight: float
) -> tuple[Tensor, dict[str, Tensor]]:
    """Novice's mean logit minus the expert's, plus the weighted penalty: to be minimised.

    Reports the distance (the first part with its sign turned), the penalty, and the accuracy
    where the halves' midpoint is the threshold.
    """
    logits = network(pairs.images, pairs.actions, pairs.tasks).float()
    expert, novice = logits[: pairs.half], logits[pairs.half :]
    distance = expert.mean() - novice.mean()
    # Batch norm in evaluation mode: what is kept Lipschitz is the function that gives rewards,
    # one row's gradient does not depend on the others, and statistics stay those of real images.
    network.eval()
    penalty = gradient_penalty(network, *interpolate(pairs, rng))
    network.train()
    middle = (expert.mean() + novice.mean()) / 2
    right = torch.cat([expert > middle, novice < middle]).float().mean()
    return weight * penalty - distance, {
        "wasserstein_distance": distance,
        "gradient_penalty": penalty,
        "discriminator_accuracy": right,
    }


def interpolate(pairs: Pairs, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Images (B, C, H, W) between expert's and novice's, with actions and tasks (B,).

    The place between the two is uniform; the action is the nearer one's.
    """
    half, device = pairs.half, pairs.images.device
    share = torch.from_numpy(rng.random(half, np.float32)).to(device)  # the expert's
    images = torch.lerp(pairs.images[half:], pairs.images[:half], share[:, None, None, None])
    actions = torch.where(share > 0.5, pairs.actions[:half], pairs.actions[half:])
    return images, actions, pairs.tasks[:half]


def gradient_penalty(critic: Critic, images: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
    """Mean of (|gradient of the logit by the image| - 1)^2, L2 norm; can be differentiated."""
    images = images.detach().requires_grad_()
    logits = critic(images, actions, tasks)
    (gradients,) = torch.autograd.grad(logits.sum(), images, create_graph=True)
    norms: Tensor = torch.linalg.vector_norm(gradients.float().flatten(1), dim=1)  # (B,)
    return (norms - 1.0).square().mean()


ALGORITHM = Algorithm(WGAILGPConfig, train, make_policy)
