"""Behavioural cloning: maximum likelihood of the demonstrator's actions (appendix B, Table 3)."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import SGD, Optimizer

from magical.errors import DemonstrationsError, InvalidConfigError
from magical.learning.algorithms import Algorithm
from magical.learning.augmentation.names import Augmentations
from magical.learning.augmentation.transformations import (
    NONE,
    PALETTE,
    TRANSFORMATIONS,
    WALLS,
    StackTransformations,
    check_transformations,
    parse_transformations,
)
from magical.learning.averaging import STATISTICS_BATCHES, renew_statistics, weight_average
from magical.learning.config import (
    AUTO,
    CHECKPOINT_SECONDS,
    IMAGE_OBSERVATIONS,
    PUBLISHED_CODE_IMAGES,
    RENDERING,
    RESAMPLING,
    ImitationConfig,
    option,
)
from magical.learning.data.expert_data import ExpertData, TaskTrajectories, load_demonstrations
from magical.learning.data.prefetch import prefetch
from magical.learning.data.rendered_data import RenderedExpertData, choose_augment_by
from magical.learning.models import PolicyNetwork, Trunk, init_last_layers
from magical.learning.running.checkpoints import (
    StateDict,
    load_module,
    load_optimizer,
    optimizer_state,
)
from magical.learning.running.devices import choose_device
from magical.learning.running.graphs import GraphedStep, use_graphs
from magical.learning.running.optimizers import make_adam, set_learning_rate
from magical.learning.running.run import Run
from magical.learning.running.streams import Purpose, seeded_init, stream
from magical.observe import STATE
from magical.runs.sources import RENDERED_STATES

ADAM_BETA_2 = 0.999


@dataclass(frozen=True, kw_only=True)
class BCConfig(ImitationConfig):
    """Settings of behavioural cloning; the defaults are Table 3's."""

    algorithm: ClassVar[str] = "bc"
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
        "published-code": PUBLISHED_CODE_IMAGES,
    }

    observation: str = option(
        "LoRes4E", "observation preset, or state", choices=(*IMAGE_OBSERVATIONS, STATE)
    )
    batches: int = option(20_000, "batches in all")
    batch_size: int = option(32, "samples per batch")
    optimizer: str = option("sgd", "optimiser", choices=("sgd", "adam"))
    learning_rate: float = option(1e-3, "initial learning rate")
    momentum: float = option(0.1, "momentum; Adam's beta 1")
    anneal: bool = option(False, "anneal the learning rate linearly to 0")
    augment_by: str = option(
        RESAMPLING,
        "augmented images are resampled, or rendered anew from the poses; auto: rendered where "
        "all demonstrations have poses",
        choices=(AUTO, RENDERING, RESAMPLING),
        added=True,
    )
    augment_scale: float = option(
        1.0, "factor of the ranges of the translation and the rotation", added=True
    )
    transform: str = option(
        NONE,
        f"transformations of the demonstrations: {NONE}, or names joined by +, of "
        f"{', '.join(TRANSFORMATIONS)}",
        metavar="NAMES",
        added=True,
    )
    average_decay: float = option(
        0.0,
        "decay, at each batch, of the exponential moving average of the weights, which is then "
        "the policy; 0: no average",
        added=True,
    )
    log_every: int = option(50, "batches between lines of metrics")
    checkpoint_every: int = option(
        0, f"batches between checkpoints; 0: one every {CHECKPOINT_SECONDS} s"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("batches", "batch_size", "learning_rate")
        self.require_positive("log_every")
        self.require_at_least_zero("checkpoint_every", "augment_scale")
        self.require_fraction("average_decay")
        check_transformations(self.transformations, self.tasks)
        if self.augment_by == RESAMPLING and WALLS in self.transformations:
            raise InvalidConfigError(
                f"transform: {WALLS} needs rendered frames, so augment_by {RENDERING} or {AUTO} is "
                f"expected, found {self.augment_by}"
            )
        if self.observation == STATE:
            self._check_state()

    def _check_state(self) -> None:
        """Raise `InvalidConfigError` for what state vectors cannot be learned with."""
        if self.augment_by == RENDERING:
            raise InvalidConfigError(
                "augment_by: state vectors are not rendered, so auto or resampling is expected, "
                f"found {self.augment_by}"
            )
        if self.augment != "none":
            raise InvalidConfigError(
                f"augment: expected none, as state vectors are not augmented, found {self.augment}"
            )
        if self.transformations:
            raise InvalidConfigError(
                f"transform: expected none, as state vectors are not transformed, found "
                f"{self.transform}"
            )
        if len(self.tasks) > 1:
            raise InvalidConfigError(
                "observation: state vectors differ between tasks, so one task is expected, found "
                f"{', '.join(self.tasks)}; use a pixel observation, or a run for each task"
            )

    @property
    def augmentations(self) -> Augmentations:
        """See `ImitationConfig`."""
        return replace(super().augmentations, scale=self.augment_scale)

    @property
    def transformations(self) -> frozenset[str]:
        """The names of the transformations."""
        return parse_transformations(self.transform)

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`."""
        changes_scenery = self.transformations & {PALETTE, WALLS}
        rendered = bool(changes_scenery) and self.augment_by != RESAMPLING
        return (*super().learned_from, *([RENDERED_STATES] if rendered else []))

    @property
    def total(self) -> int:
        """All batches."""
        return self.batches

    @property
    def training_samples(self) -> int:
        """The samples of all batches."""
        return self.total * self.batch_size

    def learning_rate_at(self, batch: int) -> float:
        """The learning rate of a batch: constant, or annealed linearly to 0."""
        left = 1.0 - batch / self.batches if self.anneal else 1.0
        return self.learning_rate * left


def train(config: BCConfig, run: Run) -> None:
    """Clone the demonstrations."""
    trainer = BCTrainer(config, run)
    demonstrations = load_demonstrations(config, run)
    trainer.fit(trainer.expert_data(demonstrations, remove_noops=True), config.batches)


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
        self.reset()
        self.compute = run.compute(self.device, config.precision, config.threads)
        if run.saved:
            load_module(self.policy, run.saved["policy"], str(run.folder))
            if self._average:
                load_module(self.network, run.saved["network"], str(run.folder))
                self._average.n_averaged.fill_(run.step)
            load_optimizer(self.optimizer, run.saved["optimizer"])

    def reset(self) -> None:
        """Initialise network and optimiser."""
        self.network = make_policy(self.config).to(self.device)
        self.optimizer = make_optimizer(self.config, self.network)
        self._forward = torch.compile(self.network) if self.config.compile else self.network
        self._graphed_step = GraphedStep(self._step, use_graphs(self.config.graphs, self.device))
        self._average = weight_average(self.network, self.config.average_decay)

    @property
    def policy(self) -> nn.Module:
        """What is evaluated: the network, or with `average_decay` its average over the batches."""
        module: nn.Module = self._average.module if self._average else self.network
        return module

    def expert_data(self, demonstrations: TaskTrajectories, remove_noops: bool) -> ExpertData:
        """The samples of demonstrations, on the trainer's device.

        How their images are augmented is recorded in `run.json`.

        Raises:
            DemonstrationsError: see `choose_augment_by` and `ExpertData`; or there are no poses
                for a transformation that needs them.
        """
        config = self.config
        kind = ExpertData
        if config.observation != STATE:
            augment_by = choose_augment_by(config.augment_by, demonstrations)
            if augment_by == RESAMPLING and WALLS in config.transformations:
                raise DemonstrationsError(
                    f"transform: {WALLS} needs demonstrations with poses, and some have recorded "
                    "frames only. Import the published files with `magical demos import`, which "
                    f"recovers their poses, or leave out {WALLS}"
                )
            self.run.describe(augment_by=augment_by)
            kind = RenderedExpertData if augment_by == RENDERING else ExpertData
        return kind(
            demonstrations,
            config.tasks,
            config.observation_spec,
            device=self.device,
            remove_noops=remove_noops,
        )

    def fit(
        self,
        data: ExpertData,
        until: int,
        extra_metrics: Mapping[str, float] | None = None,
        extra_state: StateDict | None = None,
    ) -> bool:
        """Train on `data` from the run's step until step `until`; true if the run stops before.

        The extras are logged with the metrics and saved with the checkpoints.
        """
        config, run = self.config, self.run
        self.network.train()
        averages = Averages(self.device)
        numbers = range(run.step, until)
        make, ahead = partial(self.sample_batch, data), data.batches_on_host
        with prefetch(make, numbers, ahead) as batches:
            for number, batch in zip(numbers, batches, strict=False):
                loss, logits = self.step(batch, config.learning_rate_at(number))
                averages.add(loss, logits, batch.actions)
                done = number + 1
                stops = run.stops(done)
                last = stops or done == until
                if last or done % config.log_every == 0:
                    metrics = averages.reset()
                    run.require_finite(done, metrics)
                    run.log(done, config.total, **(extra_metrics or {}), **metrics)
                if last or run.checkpoint_is_due(done, config.checkpoint_every):
                    if self._average:
                        self._renew_statistics(data, done)
                    run.checkpoint(done, {**self.state_dict(), **(extra_state or {})})
                if stops:
                    return True
        return False

    def _renew_statistics(self, data: ExpertData, done: int) -> None:
        """Batch norm's statistics of the averaged weights, from the last batches."""
        numbers = range(max(0, done - STATISTICS_BATCHES), done)
        make = partial(self.sample_batch, data)
        with prefetch(make, numbers, data.batches_on_host) as batches, self.compute.autocast():
            renew_statistics(self.policy, ((batch.images, batch.tasks) for batch in batches))

    def sample_batch(self, data: ExpertData, number: int) -> Batch:
        """Batch `number`: a function of the data, the seed and the number alone."""
        rng = stream(self.config.seed, Purpose.BATCHES, number)
        rows = data.sample(self.config.batch_size, rng)
        if self.config.observation == STATE:
            return Batch(data.images(rows), *data.labels(rows))
        config, (actions, tasks) = self.config, data.labels(rows)
        transformed = StackTransformations.sample(len(rows), config.transformations, rng)
        images = data.augmented(rows, config.augmentations, rng, transformed)
        return Batch(images, transformed.labels(actions), tasks)

    def step(self, batch: Batch, learning_rate: float) -> tuple[Tensor, Tensor]:
        """Take one step of the optimiser; returns the loss and the logits (B, 18)."""
        set_learning_rate(self.optimizer, learning_rate)
        loss, logits = self._graphed_step(*batch)
        if self._average:
            self._average.update_parameters(self.network)
        return loss, logits

    def _step(self, images: Tensor, actions: Tensor, tasks: Tensor) -> tuple[Tensor, Tensor]:
        with self.compute.autocast():
            logits = self._forward(images, tasks)
        loss = bc_loss(logits, actions)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        self.optimizer.step()
        return loss.detach(), logits.detach()

    def state_dict(self) -> StateDict:
        """The state of network and optimiser."""
        state = {
            "policy": self.policy.state_dict(),
            "optimizer": optimizer_state(self.optimizer),
        }
        return {**state, "network": self.network.state_dict()} if self._average else state


def make_policy(config: BCConfig) -> PolicyNetwork:
    """The policy network, with batch norm (appendix B), initialised from the seed."""
    with seeded_init(config.seed):
        trunk = Trunk(
            config.network, config.input_shape, batch_norm=True, pixel_range=config.pixel_range
        )
        network = PolicyNetwork(trunk, len(config.tasks))
        init_last_layers(config, network.policy)
        return network


def make_optimizer(config: BCConfig, network: nn.Module) -> Optimizer:
    """The configured optimiser."""
    momentum = config.momentum
    rate: Any = config.learning_rate
    if config.optimizer == "sgd":
        if next(network.parameters()).is_cuda:
            rate = torch.tensor(rate, device="cuda")
        return SGD(network.parameters(), rate, momentum, fused=True)
    return make_adam(network.parameters(), rate, (momentum, ADAM_BETA_2))


class Averages:
    """Loss, accuracy and throughput since the last reset, summed on the device."""

    def __init__(self, device: str) -> None:
        self._sums = torch.zeros(2, device=device)
        self._samples = 0
        self._start = time.perf_counter()

    def add(self, loss: Tensor, logits: Tensor, actions: Tensor) -> None:
        """Add a batch."""
        correct = (logits.detach().argmax(dim=1) == actions).sum()
        self._sums += torch.stack([loss.detach() * len(actions), correct])
        self._samples += len(actions)

    def reset(self) -> dict[str, float]:
        """Return the averages as metrics, and start again from 0."""
        loss, accuracy = (self._sums / self._samples).tolist()
        speed = self._samples / (time.perf_counter() - self._start)
        self._sums.zero_()
        self._samples = 0
        self._start = time.perf_counter()
        return {"loss": loss, "accuracy": accuracy, "samples_per_second": speed}


ALGORITHM = Algorithm(BCConfig, train, make_policy)
