"""Behavioural cloning: maximum likelihood of the demonstrator's actions (appendix B, Table 3)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from msgspec import Meta
from torch import Tensor
from torch.nn import functional
from torch.optim import SGD, Adam

from magical.errors import InvalidConfigError
from magical.observe import STATE
from magical_baselines.config import (
    IMAGE_OBSERVATIONS,
    Algorithm,
    PaperNetworkConfig,
    PositiveFloat,
    SupervisedConfig,
    augment_option,
    option,
)
from magical_baselines.data import ExpertData, TaskTrajectories, load_demonstrations
from magical_baselines.models import PolicyNetwork, Trunk, init_normal
from magical_baselines.training import (
    Purpose,
    Run,
    anneal,
    fit,
    gradient_step,
    seeded_init,
    stream,
)

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


def bc_loss(logits: Tensor, actions: Tensor) -> Tensor:
    """Mean negative log-likelihood of actions (B,) under logits (B, 18): to be minimised."""
    return functional.cross_entropy(logits.float(), actions)


def train(config: BCConfig, run: Run) -> None:
    """Clone the demonstrations."""
    BCTrainer(config, run).fit(load_demonstrations(config, run))


class BCTrainer:
    """A policy network and its optimiser."""

    def __init__(self, config: BCConfig, run: Run) -> None:
        """Create a new trainer, or resume from the run's checkpoint."""
        self.config, self.run, self.compute = config, run, run.compute
        self.network = make_policy(config).to(self.compute.device)
        parameters, rate = self.network.parameters(), config.learning_rate
        self.optimizer = (
            Adam(parameters, rate, (config.momentum, ADAM_BETA_2), fused=True)
            if config.optimizer == "adam"
            else SGD(parameters, rate, config.momentum, fused=True)
        )
        run.keep(policy=self.network, optimizer=self.optimizer)

    def fit(
        self,
        demonstrations: TaskTrajectories,
        until: int | None = None,
        extra_metrics: Mapping[str, float | str] = {},
    ) -> bool:
        """Train on all but no-ops, from the run's step to step `until`, by default the last.

        The extra metrics are logged with the others. Returns whether the run stops early.
        """
        config = self.config
        data = ExpertData(
            demonstrations,
            config.tasks,
            config.observation_spec,
            device=self.compute.device,
            remove_noops=True,
        )
        metrics = {**extra_metrics, "samples": len(data)} if extra_metrics else {}
        self.network.train()
        return fit(
            self.run,
            lambda number: sample_batch(config, data, number),
            self.update,
            until=until,
            extra_metrics=metrics,
        )

    def update(self, number: int, batch: Batch) -> dict[str, Tensor]:
        """Take one optimiser step; returns loss and accuracy."""
        if self.config.anneal:
            anneal(self.optimizer, number, self.config.num_updates)
        with self.compute.autocast():
            logits = self.network(batch.images, batch.tasks)  # (B, 18)
        loss = bc_loss(logits, batch.actions)
        gradient_step(self.optimizer, loss)
        return {"loss": loss, "accuracy": (logits.argmax(dim=1) == batch.actions).float().mean()}


def sample_batch(config: BCConfig, data: ExpertData, number: int) -> Batch:
    """Batch `number`: depends only on the data, the configuration and the number."""
    rng = stream(config.seed, Purpose.BATCHES, number)
    rows = data.sample(config.batch_size, rng)
    actions, tasks = data.labels(rows)
    if config.observes_vectors:
        return Batch(data.images(rows), actions, tasks)
    images = data.augmented(rows, config.augmentations(config.augment), rng)
    return Batch(images, actions, tasks)


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
