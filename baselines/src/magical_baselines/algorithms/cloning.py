"""What the learners that clone demonstrations share: training, and chunks of actions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from magical.errors import InvalidConfigError
from magical.evaluation.policy import Actions, Mask
from magical.scene import NUM_ACTIONS, PARTS
from magical_baselines.config import (
    NetworkConfig,
    PositiveFloat,
    PositiveInt,
    SupervisedConfig,
    augment_option,
    option,
)
from magical_baselines.data import ExpertData as ExpertData
from magical_baselines.data import TaskTrajectories, load_demonstrations
from magical_baselines.policy import TrainedPolicy, choose_actions
from magical_baselines.training import Purpose, Run, anneal, fit, gradient_step, stream

Floats = NDArray[np.float64]
# Configuration, demonstrations, random numbers -> a batch, depending on nothing else.
Sample = Callable[[Any, ExpertData, np.random.Generator], Any]
# Network, batch -> metrics, of which `loss` is minimised.
Losses = Callable[[Any, Any], Mapping[str, Tensor]]

WEIGHT_DECAY, MAX_GRAD_NORM = 1e-4, 10.0
QUICK = {"network": "narrow", "batches": 2400, "precision": "auto"}  # settings of the preset
# How many numbers a network returns per action: logits, or the action itself.
ACTION_SIZES = {"discrete": NUM_ACTIONS, "continuous": len(PARTS)}


class Cloning:
    """Fits a network, the run's policy, to demonstrations."""

    def __init__(
        self,
        config: SupervisedConfig,
        run: Run,
        network: nn.Module,
        optimizer: Optimizer,
        sample: Sample,
        losses: Losses,
        *,
        anneals: bool = True,
        max_grad_norm: float | None = None,
    ) -> None:
        """Start from the run's checkpoint, if there is one.

        The learning rate is annealed linearly to 0 if `anneals`.
        """
        self.config, self.run, self.network, self.optimizer = config, run, network, optimizer
        self._sample, self._losses = sample, losses
        self._anneals, self._max_grad_norm = anneals, max_grad_norm
        run.keep(policy=network, optimizer=optimizer)

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
            device=self.run.compute.device,
            remove_noops=True,
        )
        metrics = {**extra_metrics, "samples": len(data)} if extra_metrics else {}
        self.network.train()

        def sample(number: int) -> Any:
            return self._sample(config, data, stream(config.seed, Purpose.BATCHES, number))

        return fit(self.run, sample, self.update, until=until, extra_metrics=metrics)

    def update(self, number: int, batch: Any) -> Mapping[str, Tensor]:
        """Take one optimiser step; returns the metrics."""
        if self._anneals:
            anneal(self.optimizer, number, self.config.num_updates)
        with self.run.compute.autocast():
            metrics = self._losses(self.network, batch)
        gradient_step(self.optimizer, metrics["loss"], self._max_grad_norm)
        return metrics


@dataclass(frozen=True, kw_only=True)
class SequenceConfig(SupervisedConfig, NetworkConfig):
    """Options of learners of sequences, whose networks AdamW fits to the demonstrations."""

    learning_rate: PositiveFloat = option(
        5e-4, "AdamW's initial learning rate; annealed linearly to 0"
    )
    augment: str = augment_option("noise+translation+rotation")


def fit_sequences(
    config: SequenceConfig, run: Run, network: nn.Module, sample: Sample, losses: Losses
) -> None:
    """Fit a network to the run's demonstrations with AdamW."""
    parameters = network.to(run.compute.device).parameters()
    optimizer = AdamW(parameters, config.learning_rate, weight_decay=WEIGHT_DECAY, fused=True)
    cloning = Cloning(config, run, network, optimizer, sample, losses, max_grad_norm=MAX_GRAD_NORM)
    cloning.fit(load_demonstrations(config, run))


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """The mean of values (...,) where a mask (...,) is true."""
    return (values * mask).sum() / mask.sum()


@dataclass(frozen=True, kw_only=True)
class ChunkConfig(SequenceConfig):
    """Options of learners of chunks."""

    chunk: PositiveInt = option(16, "actions in a chunk")
    execute: PositiveInt = option(1, "steps between predictions of chunks")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.execute > self.chunk:
            raise InvalidConfigError(
                f"execute: expected at most the {self.chunk} actions of a chunk, found "
                f"{self.execute}"
            )


class Chunks(NamedTuple):
    """Samples of demonstrations, each with the K actions that start there."""

    images: Tensor  # (B, C, H, W) float32 in [0, 1]
    actions: Tensor  # (B, K) int64, or (B, K, 3) float32 if continuous
    exist: Tensor  # (B, K) bool: false beyond the demonstration's end, and after another action
    padded: Tensor  # (B, K) bool: true beyond the demonstration's end
    tasks: Tensor  # (B,) int64


def sample_chunks(config: ChunkConfig, data: ExpertData, rng: np.random.Generator) -> Chunks:
    """Sample a batch.

    If no-ops have been left out of the data, a chunk has the next actions that are not no-ops.
    Beyond a demonstration's end, its last action is repeated. Where another action than the label
    was executed, as in perturbed demonstrations, the rest of the chunk is unknown.
    """
    rows = data.sample(config.batch_size, rng)
    images = data.augmented(rows, config.augmentations(config.augment), rng)
    chosen, exist = data.neighbours(rows, np.arange(config.chunk))
    actions, tasks = data.labels(chosen)
    masks = np.stack([exist, ~exist & data.is_last[chosen]])
    known, padded = torch.from_numpy(masks).to(data.device)
    return Chunks(images, actions, known, padded, tasks[:, 0])


class ChunkPolicy(TrainedPolicy):
    """Predicts a chunk every `execute` steps, and combines those that predict the current step.

    A new chunk replaces what is left of the previous one. With an `ensemble_decay` m, all chunks
    that predict a step are averaged, the n-th with weight exp(-m n), the oldest being number 0.

    The network maps observations (B, ...) and tasks (B,) to chunks (B, K, D): logits of the 18
    actions, whose probabilities are averaged, or continuous actions. Each environment has its own
    state: when it predicts does not depend on when episodes start elsewhere in the batch.
    """

    config: ChunkConfig
    _sums: Floats  # (B, K, D): the weighted sums of the predictions for the next K steps
    _weights: Floats  # (B, K): the sums of the weights
    _counts: NDArray[np.int64]  # (B, K): the number of predictions
    _steps: NDArray[np.int64]  # (B,): steps since the episode's start

    def reset(self, mask: Mask) -> None:
        """Forget the chunks of the environments in which an episode starts."""
        if mask.all():
            shape = len(mask), self.config.chunk
            self._sums = np.zeros((*shape, ACTION_SIZES[self.action_space]))
            self._weights = np.zeros(shape)
            self._counts = np.zeros(shape, np.int64)
            self._steps = np.zeros(len(mask), np.int64)
        for array in (self._sums, self._weights, self._counts, self._steps):
            array[mask] = 0

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        due = self._steps % self.config.execute == 0
        inputs = self.extra_inputs(len(env_ids), rng)
        if due.any():
            chunks = self.outputs(observations, env_ids, *inputs)
            if self.action_space == "discrete":
                chunks = chunks.softmax(dim=2)
            self._add(chunks.numpy(), due)
        action = self._sums[:, 0] / self._weights[:, :1]
        for array in (self._sums, self._weights, self._counts):
            array[:, :-1] = array[:, 1:]
            array[:, -1] = 0
        self._steps += 1
        if self.action_space == "continuous":
            return action.clip(-1.0, 1.0)
        return choose_actions(action, rng, self.greedy)

    @property
    def ensemble_decay(self) -> float | None:
        return None

    def extra_inputs(self, count: int, rng: np.random.Generator) -> Sequence[Tensor]:
        """Further inputs of the network, after observations and tasks; sampled in every step."""
        return ()

    def _add(self, chunks: Floats, due: Mask) -> None:
        if self.ensemble_decay is None:
            for array in (self._sums, self._weights, self._counts):
                array[due] = 0
        weights = np.exp(-(self.ensemble_decay or 0.0) * self._counts) * due[:, None]
        self._sums += weights[:, :, None] * chunks
        self._weights += weights
        self._counts += due[:, None]
