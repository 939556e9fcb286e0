"""Chunks of actions: batches, training, and policies whose network predicts chunks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import AdamW

from magical.errors import InvalidConfigError
from magical.evaluation.policy import Actions, Mask
from magical.scene.actions import NUM_ACTIONS, PARTS
from magical_baselines.config import (
    NetworkConfig,
    PositiveFloat,
    PositiveInt,
    SupervisedConfig,
    augment_option,
    option,
)
from magical_baselines.data import ExpertData as ExpertData
from magical_baselines.data import load_demonstrations
from magical_baselines.policy import TrainedPolicy, choose_actions
from magical_baselines.training import Purpose, Run, anneal, fit, gradient_step, stream

Floats = NDArray[np.float64]
AnyConfig = TypeVar("AnyConfig", bound="SequenceConfig")
Network = TypeVar("Network", bound=nn.Module)
Batch = TypeVar("Batch")

WEIGHT_DECAY, MAX_GRAD_NORM = 1e-4, 10.0
QUICK = {"network": "narrow", "batches": 2400, "precision": "auto"}  # settings of the preset
# How many numbers a network returns per action: logits, or the action itself.
ACTION_SIZES = {"discrete": NUM_ACTIONS, "continuous": len(PARTS)}


@dataclass(frozen=True, kw_only=True)
class SequenceConfig(SupervisedConfig, NetworkConfig):
    """Options of learners of sequences, whose networks AdamW fits to the demonstrations."""

    learning_rate: PositiveFloat = option(
        5e-4, "AdamW's initial learning rate; annealed linearly to 0"
    )
    augment: str = augment_option("noise+translation+rotation")


def fit_sequences(
    config: AnyConfig,
    run: Run,
    network: Network,
    sample: Callable[[AnyConfig, ExpertData, np.random.Generator], Batch],
    losses: Callable[[Network, Batch], Mapping[str, Tensor]],
) -> None:
    """Fit a network, the run's policy, to the demonstrations without no-ops.

    `sample` returns a batch, depending only on its arguments, and `losses` the metrics of a batch,
    of which `loss` is minimised. Raises what `load_demonstrations` and `ExpertData` raise.
    """
    compute = run.compute
    data = ExpertData(
        load_demonstrations(config, run),
        config.tasks,
        config.observation_spec,
        device=compute.device,
        remove_noops=True,
    )
    network.to(compute.device).train()
    optimizer = AdamW(
        network.parameters(), config.learning_rate, weight_decay=WEIGHT_DECAY, fused=True
    )
    run.keep(policy=network, optimizer=optimizer)

    def update(number: int, batch: Batch) -> Mapping[str, Tensor]:
        anneal(optimizer, number, config.num_updates)
        with compute.autocast():
            metrics = losses(network, batch)
        gradient_step(optimizer, metrics["loss"], MAX_GRAD_NORM)
        return metrics

    def make(number: int) -> Batch:
        return sample(config, data, stream(config.seed, Purpose.BATCHES, number))

    fit(run, make, update)


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
        """See `TrainedPolicy`."""
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
        """See the class; `None`: chunks are not averaged."""
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
