"""Behavioural cloning: maximum likelihood of the demonstrator's actions (appendix B, Table 3)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import SGD, Adam, Optimizer

from magical.errors import InvalidConfigError
from magical.observe import STATE
from magical_baselines.algorithms import Algorithm
from magical_baselines.augmentation.names import Augmentations, augment_option
from magical_baselines.config import (
    IMAGE_OBSERVATIONS,
    PUBLISHED,
    Config,
    DemonstrationSettings,
    NetworkSettings,
)
from magical_baselines.data.expert_data import ExpertData, TaskTrajectories, load_demonstrations
from magical_baselines.data.prefetch import prefetch
from magical_baselines.models import PolicyNetwork, Trunk, init_normal
from magical_baselines.running.averages import Averages
from magical_baselines.running.checkpoints import StateDict, restoring
from magical_baselines.running.devices import choose_device
from magical_baselines.running.optimizers import load_optimizer, optimizer_state, set_learning_rate
from magical_baselines.running.run import Run
from magical_baselines.running.streams import Purpose, seeded_init, stream
from magical_baselines.settings import BELOW_1, POSITIVE, Settings, option

ADAM_BETA_2 = 0.999


@dataclass(frozen=True, kw_only=True)
class CloningSettings(Settings):
    """How demonstrations are cloned; the defaults are Table 3's."""

    batches: int = option(20_000, "training batches", POSITIVE)
    batch_size: int = option(32, "samples per batch", POSITIVE)
    optimizer: str = option("sgd", "optimiser", choices=("sgd", "adam"))
    learning_rate: float = option(1e-3, "initial learning rate", POSITIVE)
    momentum: float = option(0.1, "momentum; Adam's beta 1", BELOW_1)
    anneal: bool = option(False, "anneal the learning rate linearly to 0")
    augment: str = augment_option("all")
    log_every: int = option(50, "batches between logged metrics", POSITIVE)


@dataclass(frozen=True, kw_only=True)
class BCConfig(Config):
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
        "published-code": {"conventions": PUBLISHED},
    }

    algorithm: str = "bc"
    networks: NetworkSettings = field(default_factory=NetworkSettings)
    demonstrations: DemonstrationSettings
    cloning: CloningSettings = field(default_factory=CloningSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.observes_vectors and self.cloning.augment != "none":
            raise InvalidConfigError(
                f"augment: expected none, as state vectors are not augmented, found "
                f"{self.cloning.augment}"
            )

    @property
    def augmentations(self) -> Augmentations:
        """The augmentations of images."""
        return self.networks.augmentations(self.cloning.augment)

    @property
    def num_updates(self) -> int:
        """The number of batches."""
        return self.cloning.batches

    @property
    def training_samples(self) -> int:
        """The samples of all batches."""
        return self.num_updates * self.cloning.batch_size

    def learning_rate_at(self, batch: int) -> float:
        """The learning rate of a batch: constant, or annealed linearly to 0."""
        left = 1.0 - batch / self.num_updates if self.cloning.anneal else 1.0
        return self.cloning.learning_rate * left


def train(config: BCConfig, run: Run) -> None:
    """Clone the demonstrations."""
    trainer = BCTrainer(config, run)
    demonstrations = load_demonstrations(config, run)
    trainer.fit(trainer.expert_data(demonstrations), config.num_updates)


class Batch(NamedTuple):
    """Samples of demonstrations."""

    images: Tensor  # (B, C, H, W) float32 in [0, 1], or state vectors (B, size)
    actions: Tensor  # (B,) int64
    tasks: Tensor  # (B,) int64


def bc_loss(logits: Tensor, actions: Tensor) -> Tensor:
    """Mean negative log-likelihood of actions (B,) under logits (B, 18): to be minimised."""
    return functional.cross_entropy(logits.float(), actions)


class BCTrainer:
    """A policy network and its optimiser."""

    def __init__(self, config: BCConfig, run: Run) -> None:
        """Create a new trainer, or resume from the run's checkpoint."""
        self.config, self.run = config, run
        self.device = choose_device(config.device)
        self.network = make_policy(config).to(self.device)
        self.optimizer = make_optimizer(config.cloning, self.network)
        self.compute = run.compute(self.device, config.network_precision, config.threads)
        if run.saved:
            with restoring(run.folder):
                self.network.load_state_dict(run.saved["policy"])
                load_optimizer(self.optimizer, run.saved["optimizer"])

    def expert_data(self, demonstrations: TaskTrajectories) -> ExpertData:
        """The samples of the demonstrations but no-ops, on the trainer's device."""
        return ExpertData(
            demonstrations,
            self.config.tasks,
            self.config.observation_spec,
            device=self.device,
            remove_noops=True,
        )

    def fit(
        self,
        data: ExpertData,
        until: int,
        extra_metrics: Mapping[str, float] = {},
        extra_state: Mapping[str, Any] = {},
    ) -> bool:
        """Train on `data` from the run's step to step `until`; true if the run stops early.

        The extras are logged with the metrics and saved in the checkpoints.
        """
        config, run = self.config, self.run
        self.network.train()
        averages = Averages()
        numbers = range(run.step, until)
        make, ahead = partial(self.sample_batch, data), data.batches_on_host
        with prefetch(make, numbers, ahead) as batches:
            for number, batch in zip(numbers, batches, strict=False):
                loss, logits = self.step(batch, config.learning_rate_at(number))
                correct = (logits.argmax(dim=1) == batch.actions).float().mean()
                averages.add(len(batch.actions), loss=loss, accuracy=correct)
                done = number + 1
                if run.finish_step(
                    done,
                    lambda: {**extra_metrics, **averages.reset(speed_of="loss")},
                    partial(self._state_dict, extra_state),
                    log_every=config.cloning.log_every,
                    last=done == until,
                ):
                    return True
        return False

    def sample_batch(self, data: ExpertData, number: int) -> Batch:
        """Batch `number`: depends only on the data, the seed and the number."""
        rng = stream(self.config.seed, Purpose.BATCHES, number)
        config = self.config
        rows = data.sample(config.cloning.batch_size, rng)
        actions, tasks = data.labels(rows)
        if config.observes_vectors:
            return Batch(data.images(rows), actions, tasks)
        return Batch(data.augmented(rows, config.augmentations, rng), actions, tasks)

    def step(self, batch: Batch, learning_rate: float) -> tuple[Tensor, Tensor]:
        """Take one optimiser step; returns the loss and the logits (B, 18)."""
        set_learning_rate(self.optimizer, learning_rate)
        with self.compute.autocast():
            logits = self.network(batch.images, batch.tasks)
        loss = bc_loss(logits, batch.actions)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        self.optimizer.step()
        return loss.detach(), logits.detach()

    def _state_dict(self, extra: Mapping[str, Any]) -> StateDict:
        return {
            "policy": self.network.state_dict(),
            "optimizer": optimizer_state(self.optimizer),
            **extra,
        }


def make_policy(config: BCConfig) -> PolicyNetwork:
    """The policy network, with batch norm (appendix B), initialised from the seed."""
    networks = config.networks
    with seeded_init(config.seed):
        trunk = Trunk(
            networks.network, config.input_shape, batch_norm=True, pixel_range=networks.pixel_range
        )
        network = PolicyNetwork(trunk, len(config.tasks))
        if networks.published:
            init_normal(network.policy)
        return network


def make_optimizer(settings: CloningSettings, network: nn.Module) -> Optimizer:
    """The configured optimiser."""
    parameters, rate, momentum = network.parameters(), settings.learning_rate, settings.momentum
    if settings.optimizer == "adam":
        return Adam(parameters, rate, (momentum, ADAM_BETA_2), fused=True)
    return SGD(parameters, rate, momentum, fused=True)


ALGORITHM = Algorithm(BCConfig, train, make_policy)
