"""Chunks of actions: samples to learn from, and policies whose network predicts chunks."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.errors import InvalidConfigError
from magical.evaluation.policy import Actions, Mask
from magical.scene.actions import NUM_ACTIONS, PARTS
from magical_baselines.data.expert_data import ExpertData
from magical_baselines.policy import TrainedPolicy, choose_actions
from magical_baselines.running.streams import Purpose, stream
from magical_baselines.sequences.fitting import SequenceConfig
from magical_baselines.settings import POSITIVE, Settings, option

Floats = NDArray[np.float64]
# How many numbers a network returns per action: logits, or the action itself.
ACTION_SIZES = {"discrete": NUM_ACTIONS, "continuous": len(PARTS)}


@dataclass(frozen=True, kw_only=True)
class ChunkSettings(Settings):
    """The length of chunks, and how much of each is executed."""

    chunk: int = option(16, "actions in a chunk", POSITIVE)
    execute: int = option(1, "steps between predictions of chunks", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.execute > self.chunk:
            raise InvalidConfigError(
                f"execute: expected at most the {self.chunk} actions of a chunk, found "
                f"{self.execute}"
            )


@dataclass(frozen=True, kw_only=True)
class ChunkConfig(SequenceConfig):
    """Base of the configurations of learners of chunks."""

    chunks: ChunkSettings = field(default_factory=ChunkSettings)


class Chunks(NamedTuple):
    """Samples of demonstrations, each with the K actions that start there."""

    images: Tensor  # (B, C, H, W) float32 in [0, 1]
    actions: Tensor  # (B, K) int64, or (B, K, 3) float32 if continuous
    exist: Tensor  # (B, K) bool: false beyond the demonstration's end, and after another action
    padded: Tensor  # (B, K) bool: true beyond the demonstration's end
    tasks: Tensor  # (B,) int64


def sample_chunks(config: ChunkConfig, data: ExpertData, number: int) -> Chunks:
    """Batch `number`: depends only on the data, the configuration and the number.

    If no-ops have been left out of the data, a chunk has the next actions that are not no-ops.
    Beyond a demonstration's end, its last action is repeated. Where another action than the label
    was executed, as in perturbed demonstrations, the rest of the chunk is unknown.
    """
    rng = stream(config.seed, Purpose.BATCHES, number)
    rows = data.sample(config.fitting.batch_size, rng)
    images = data.augmented(rows, config.fitting.augmentations, rng)
    chosen, exist = data.neighbours(rows, np.arange(config.chunks.chunk))
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
            shape = len(mask), self.config.chunks.chunk
            self._sums = np.zeros((*shape, ACTION_SIZES[self.action_space]))
            self._weights = np.zeros(shape)
            self._counts = np.zeros(shape, np.int64)
            self._steps = np.zeros(len(mask), np.int64)
        for array in (self._sums, self._weights, self._counts, self._steps):
            array[mask] = 0

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """See `TrainedPolicy`."""
        due = self._steps % self.config.chunks.execute == 0
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
