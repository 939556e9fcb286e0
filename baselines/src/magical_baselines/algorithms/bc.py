"""Behavioural cloning: maximum likelihood of the demonstrator's actions (appendix B, Table 3)."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import SGD, Adam, Optimizer
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from magical.errors import InvalidConfigError
from magical.observe import STATE
from magical.runs.sources import RENDERED_STATES
from magical_baselines.algorithms import Algorithm
from magical_baselines.augmentation.names import Augmentations, augment_option
from magical_baselines.augmentation.transformations import (
    NONE,
    PALETTE,
    TRANSFORMATIONS,
    WALLS,
    StackTransformations,
    check_transformations,
    parse_transformations,
)
from magical_baselines.config import (
    IMAGE_OBSERVATIONS,
    PUBLISHED,
    Config,
    DemonstrationSettings,
    NetworkSettings,
)
from magical_baselines.data.expert_data import ExpertData, TaskTrajectories, load_demonstrations
from magical_baselines.data.prefetch import prefetch
from magical_baselines.data.rendered_data import AUTO, RENDERING, RESAMPLING, choose_image_data
from magical_baselines.models import PolicyNetwork, Trunk, init_normal, new_statistics
from magical_baselines.running.averages import Averages
from magical_baselines.running.checkpoints import StateDict, restoring
from magical_baselines.running.devices import choose_device
from magical_baselines.running.optimizers import load_optimizer, optimizer_state, set_learning_rate
from magical_baselines.running.run import Run
from magical_baselines.running.streams import Purpose, seeded_init, stream
from magical_baselines.settings import BELOW_1, NOT_NEGATIVE, POSITIVE, Settings, option

ADAM_BETA_2 = 0.999
STATISTICS_BATCHES = 50  # batches that give the averaged weights their batch-norm statistics


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
    augment_by: str = option(
        RESAMPLING,
        "resample augmented images, or render them anew from the poses; auto: render if all "
        "demonstrations have poses",
        choices=(AUTO, RENDERING, RESAMPLING),
    )
    augment_scale: float = option(
        1.0, "factor that scales the ranges of translations and rotations", NOT_NEGATIVE
    )
    transform: str = option(
        NONE,
        f"transformations of the demonstrations: {NONE}, or some of "
        f"{', '.join(TRANSFORMATIONS)}, joined by +",
        metavar="NAMES",
    )
    average_decay: float = option(
        0.0,
        "decay per batch of an exponential moving average of the weights, which the policy then "
        "uses; 0: no averaging",
        BELOW_1,
    )
    log_every: int = option(50, "batches between logged metrics", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.augment_by == RESAMPLING and WALLS in self.transformations:
            raise InvalidConfigError(
                f"transform: {WALLS} needs rendered frames, so augment_by {RENDERING} or {AUTO} is "
                f"expected, found {self.augment_by}"
            )

    @property
    def transformations(self) -> frozenset[str]:
        """The names of the transformations."""
        return parse_transformations(self.transform)


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
            "augment_by": AUTO,
        },
        "published-code": {"conventions": PUBLISHED},
    }

    algorithm: str = "bc"
    networks: NetworkSettings = field(default_factory=NetworkSettings)
    demonstrations: DemonstrationSettings
    cloning: CloningSettings = field(default_factory=CloningSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_transformations(self.cloning.transformations, self.tasks)
        if self.observes_vectors:
            _check_vectors(self.cloning)

    @property
    def augmentations(self) -> Augmentations:
        """The augmentations of images."""
        chosen = self.networks.augmentations(self.cloning.augment)
        return replace(chosen, scale=self.cloning.augment_scale)

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`."""
        cloning = self.cloning
        # Scenes may be rendered with other colours or walls than the recorded ones.
        changed = cloning.transformations & {PALETTE, WALLS} and cloning.augment_by != RESAMPLING
        rendered = (RENDERED_STATES,) if changed else ()
        return (*super().learned_from, *rendered)

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


def _check_vectors(cloning: CloningSettings) -> None:
    """Raise `InvalidConfigError` for settings that do not work with state vectors."""
    what = "state vectors are not"
    if cloning.augment_by == RENDERING:
        problem = f"augment_by: {what} rendered, so auto or resampling is expected"
    elif cloning.augment != "none":
        problem = f"augment: expected none, as {what} augmented, found {cloning.augment}"
    elif cloning.transformations:
        problem = f"transform: expected none, as {what} transformed, found {cloning.transform}"
    else:
        return
    raise InvalidConfigError(problem)


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
        decay = config.cloning.average_decay
        average = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]  # PyTorch's
        self._average = AveragedModel(self.network, multi_avg_fn=average) if decay else None
        self.compute = run.compute(self.device, config.network_precision, config.threads)
        if run.saved:
            with restoring(run.folder):
                self.policy.load_state_dict(run.saved["policy"])
                if self._average:
                    self.network.load_state_dict(run.saved["network"])
                    self._average.n_averaged.fill_(run.step)
                load_optimizer(self.optimizer, run.saved["optimizer"])

    @property
    def policy(self) -> nn.Module:
        """The evaluated module: the network or, with `average_decay`, its moving average."""
        return self._average.module if self._average else self.network

    def expert_data(self, demonstrations: TaskTrajectories) -> ExpertData:
        """The samples of the demonstrations but no-ops, on the trainer's device.

        Raises:
            DemonstrationsError, RunFolderError: see `choose_image_data`.
        """
        config, cloning, kind = self.config, self.config.cloning, ExpertData
        if not config.observes_vectors:
            names = cloning.transformations
            kind = choose_image_data(
                demonstrations, self.run, config.observation_spec, cloning.augment_by, names
            )
        return kind(
            demonstrations,
            config.tasks,
            config.observation_spec,
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
                    partial(self._state_dict, data, done, extra_state),
                    log_every=config.cloning.log_every,
                    last=done == until,
                ):
                    return True
        return False

    def _renew_statistics(self, data: ExpertData, done: int) -> None:
        """Recompute batch norm's statistics for the averaged weights, from the last batches."""
        numbers = range(max(0, done - STATISTICS_BATCHES), done)
        make = partial(self.sample_batch, data)
        self.policy.train()
        with (
            new_statistics(self.policy),
            prefetch(make, numbers, data.batches_on_host) as batches,
            self.compute.autocast(),
        ):
            for batch in batches:
                self.policy(batch.images, batch.tasks)
        self.policy.eval()

    def sample_batch(self, data: ExpertData, number: int) -> Batch:
        """Batch `number`: depends only on the data, the seed and the number."""
        rng = stream(self.config.seed, Purpose.BATCHES, number)
        config, cloning = self.config, self.config.cloning
        rows = data.sample(cloning.batch_size, rng)
        actions, tasks = data.labels(rows)
        if config.observes_vectors:
            return Batch(data.images(rows), actions, tasks)
        transformed = StackTransformations.sample(len(rows), cloning.transformations, rng)
        images = data.augmented(rows, config.augmentations, rng, transformed)
        return Batch(images, transformed.labels(actions), tasks)

    def step(self, batch: Batch, learning_rate: float) -> tuple[Tensor, Tensor]:
        """Take one optimiser step; returns the loss and the logits (B, 18)."""
        set_learning_rate(self.optimizer, learning_rate)
        with self.compute.autocast():
            logits = self.network(batch.images, batch.tasks)
        loss = bc_loss(logits, batch.actions)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        self.optimizer.step()
        if self._average:
            self._average.update_parameters(self.network)
        return loss.detach(), logits.detach()

    def _state_dict(self, data: ExpertData, done: int, extra: Mapping[str, Any]) -> StateDict:
        """The state of network and optimiser after `done` batches of the data."""
        averaged = {}
        if self._average:
            self._renew_statistics(data, done)
            averaged = {"network": self.network.state_dict()}
        return {
            "policy": self.policy.state_dict(),
            "optimizer": optimizer_state(self.optimizer),
            **averaged,
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
