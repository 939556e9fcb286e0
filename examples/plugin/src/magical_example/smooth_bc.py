"""Behavioural cloning with label smoothing: an algorithm in one file.

The loss is the cross-entropy with targets that give the demonstrator's action 1 - epsilon, and
share epsilon among all actions (Szegedy et al., 2016).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from magical_baselines.augmentation.augment import to_unit
from magical_baselines.config import (
    Algorithm,
    Fraction,
    NetworkConfig,
    PositiveFloat,
    PositiveInt,
    SupervisedConfig,
    option,
)
from magical_baselines.data import ExpertData, load_demonstrations
from magical_baselines.models import PolicyNetwork, Trunk
from magical_baselines.training import Purpose, Run, fit, gradient_step, seeded_init, stream

Batch = tuple[Tensor, Tensor, Tensor]  # images (B, C, H, W), actions (B,), tasks (B,)


@dataclass(frozen=True, kw_only=True)
class SmoothBCConfig(SupervisedConfig, NetworkConfig):
    """Settings of behavioural cloning with label smoothing."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {"network": "narrow", "batches": 1000},
    }

    algorithm: str = "smooth-bc"
    smoothing: Fraction = option(0.1, "epsilon: what all actions share")
    batches: PositiveInt = option(5000, "training batches")
    learning_rate: PositiveFloat = option(1e-3, "Adam's learning rate")


def train(config: SmoothBCConfig, run: Run) -> None:
    """Train on batches of the demonstrations, from the run's newest checkpoint on."""
    network = make_policy(config).to(run.compute.device).train()
    optimizer = torch.optim.Adam(network.parameters(), config.learning_rate)
    run.keep(policy=network, optimizer=optimizer)
    data = ExpertData(
        load_demonstrations(config, run),
        config.tasks,
        config.observation_spec,
        device=run.compute.device,
    )

    def sample(number: int) -> Batch:
        rows = data.sample(config.batch_size, stream(config.seed, Purpose.BATCHES, number))
        return to_unit(data.images(rows)), *data.labels(rows)

    def update(number: int, batch: Batch) -> dict[str, Tensor]:
        images, actions, tasks = batch
        with run.compute.autocast():
            logits = network(images, tasks)  # (B, 18)
        loss = smooth_loss(logits, actions, config.smoothing)
        gradient_step(optimizer, loss)
        return {"loss": loss}

    fit(run, sample, update)


def smooth_loss(logits: Tensor, actions: Tensor, smoothing: float) -> Tensor:
    """Mean cross-entropy of logits (B, 18) and smoothed actions (B,): to be minimised."""
    return functional.cross_entropy(logits.float(), actions, label_smoothing=smoothing)


def make_policy(config: SmoothBCConfig) -> PolicyNetwork:
    """The policy network, initialised from the seed."""
    with seeded_init(config.seed):
        trunk = Trunk(config.network, config.input_shape, batch_norm=True)
        return PolicyNetwork(trunk, len(config.tasks))


ALGORITHM = Algorithm(SmoothBCConfig, train, make_policy)
