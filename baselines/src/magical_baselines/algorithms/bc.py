"""Behavioural cloning: maximum likelihood of the demonstrator's actions (appendix B, Table 3)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from msgspec import Meta
from torch import Tensor
from torch.nn import functional
from torch.optim import SGD, Adam, Optimizer

from magical.errors import InvalidConfigError
from magical.observe import STATE
from magical_baselines.algorithms.cloning import Cloning
from magical_baselines.config import (
    IMAGE_OBSERVATIONS,
    Algorithm,
    PaperNetworkConfig,
    PositiveFloat,
    SupervisedConfig,
    augment_option,
    option,
)
from magical_baselines.data import ExpertData, load_demonstrations
from magical_baselines.models import PolicyNetwork, Trunk, init_normal
from magical_baselines.training import Run, seeded_init

ADAM_BETA_2 = 0.999


@dataclass(frozen=True, kw_only=True)
class BCConfig(SupervisedConfig, PaperNetworkConfig):
    """Settings of behavioural cloning; the defaults are Table 3's."""

    observations: ClassVar[tuple[str, ...]] = (*IMAGE_OBSERVATIONS, STATE)
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {
            "network": "narrow",
            "batches": 2400,
            "precision": "auto",
            "optimizer": "adam",
            "learning_rate": 1e-3,
            "momentum": 0.9,
            "anneal": True,
            "augment": "noise+translation+rotation",
        },
        "published-code": {"conventions": "published"},
    }

    algorithm: str = "bc"
    optimizer: Literal["sgd", "adam"] = option("sgd", "optimiser")
    learning_rate: PositiveFloat = option(1e-3, "initial learning rate")
    momentum: Annotated[float, Meta(ge=0, lt=1)] = option(0.1, "momentum; Adam's beta 1")
    anneal: bool = option(False, "anneal the learning rate linearly to 0")
    augment: str = augment_option("all")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.observes_vectors and self.augment != "none":
            raise InvalidConfigError(
                f"augment: expected none, as state vectors are not augmented, found {self.augment}"
            )


class Batch(NamedTuple):
    """Samples of demonstrations."""

    images: Tensor  # (B, C, H, W) float32 in [0, 1], or state vectors (B, size)
    actions: Tensor  # (B,) int64
    tasks: Tensor  # (B,) int64


def bc_losses(network: PolicyNetwork, batch: Batch) -> dict[str, Tensor]:
    """The loss to be minimised, the mean negative log-likelihood of the actions; and accuracy."""
    logits = network(batch.images, batch.tasks)  # (B, 18)
    loss = functional.cross_entropy(logits.float(), batch.actions)
    return {"loss": loss, "accuracy": (logits.argmax(dim=1) == batch.actions).float().mean()}


def sample_batch(config: BCConfig, data: ExpertData, rng: np.random.Generator) -> Batch:
    """Sample a batch of augmented images, or of state vectors."""
    rows = data.sample(config.batch_size, rng)
    actions, tasks = data.labels(rows)
    if config.observes_vectors:
        return Batch(data.images(rows), actions, tasks)
    images = data.augmented(rows, config.augmentations(config.augment), rng)
    return Batch(images, actions, tasks)


def make_optimizer(config: BCConfig, parameters: Iterable[Tensor]) -> Optimizer:
    """The optimiser of the configuration."""
    rate = config.learning_rate
    if config.optimizer == "adam":
        return Adam(parameters, rate, (config.momentum, ADAM_BETA_2), fused=True)
    return SGD(parameters, rate, config.momentum, fused=True)


def make_cloning(config: BCConfig, run: Run) -> Cloning:
    """The policy network and what trains it."""
    network = make_policy(config).to(run.compute.device)
    optimizer = make_optimizer(config, network.parameters())
    return Cloning(config, run, network, optimizer, sample_batch, bc_losses, anneals=config.anneal)


def train(config: BCConfig, run: Run) -> None:
    """Clone the demonstrations."""
    make_cloning(config, run).fit(load_demonstrations(config, run))


def make_policy(config: BCConfig) -> PolicyNetwork:
    """The policy network, with batch norm (appendix B), initialised from the seed."""
    with seeded_init(config.seed):
        trunk = Trunk(
            config.network, config.input_shape, batch_norm=True, pixel_range=config.pixel_range
        )
        network = PolicyNetwork(trunk, len(config.tasks))
        if config.published:
            init_normal(network.policy)
        return network


ALGORITHM = Algorithm(BCConfig, train, make_policy)
