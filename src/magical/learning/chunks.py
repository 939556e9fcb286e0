"""Policies that predict chunks of actions: several steps at once, as a network's one output."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from magical.evaluation.policy import Actions, Mask
from magical.learning.policy import TrainedPolicy, choose_actions
from magical.learning.settings import NOT_NEGATIVE, POSITIVE, Settings, option
from magical.scene.actions import NUM_ACTIONS, PARTS

Floats = NDArray[np.float64]
# Numbers that a network returns for an action: logits, or the action itself.
ACTION_SIZES = {"discrete": NUM_ACTIONS, "continuous": len(PARTS)}


@dataclass(frozen=True, kw_only=True)
class ChunkSettings(Settings):
    """The length of chunks, and what of them is executed."""

    chunk: int = option(16, "actions in a chunk", POSITIVE)
    execute: int = option(1, "steps from one chunk to the next", POSITIVE)


@dataclass(frozen=True, kw_only=True)
class EnsembleSettings(ChunkSettings):
    """Chunks that overlap are averaged."""

    ensemble: float = option(
        0.01,
        "temporal ensembling: weight exp(-x n) of the n-th of the chunks that predict a step, the "
        "oldest first",
        NOT_NEGATIVE,
    )


class ChunkPolicy(TrainedPolicy):
    """Predicts a chunk every so many steps, and averages those that predict the present step.

    The network maps observations (B, ...) and tasks (B,) to chunks (B, K, D): logits of the 18
    actions, or continuous actions. One with `noise_shape` also takes normal noise of that shape
    for each row.
    """

    _weights: Floats  # (B, K) sums of the weights of the predictions of the next K steps
    _sums: Floats  # (B, K, D) of the weighted predictions
    _counts: NDArray[np.int64]  # (B, K) of the predictions
    _steps: NDArray[np.int64]  # (B,) since the last chunk

    def reset(self, mask: Mask) -> None:
        """Forget the chunks of the environments in which an episode starts."""
        settings = self.config.part(ChunkSettings)
        assert settings is not None
        self._settings = settings
        length, size = settings.chunk, ACTION_SIZES[self.action_space]
        if mask.all():
            self._weights = np.zeros((len(mask), length))
            self._sums = np.zeros((len(mask), length, size))
            self._counts = np.zeros((len(mask), length), np.int64)
            self._steps = np.zeros(len(mask), np.int64)
        for array in (self._weights, self._sums, self._counts, self._steps):
            array[mask] = 0

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """See `TrainedPolicy`."""
        due = self._steps % self._settings.execute == 0
        if due.any():
            self._add(self._predict(observations, env_ids, rng), due)
        chosen = self._sums[:, 0] / self._weights[:, :1]
        for array in (self._weights, self._sums, self._counts):
            array[:, :-1] = array[:, 1:]
            array[:, -1] = 0
        self._steps += 1
        if self.action_space == "continuous":
            return chosen.clip(-1.0, 1.0)
        return choose_actions(chosen, rng, self.greedy)

    def _predict(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Floats:
        """Chunks (B, K, D) of probabilities or of continuous actions."""
        shape = getattr(self.network, "noise_shape", None)
        noise = [] if shape is None else [rng.standard_normal((len(env_ids), *shape))]
        outputs = self.outputs(
            observations, env_ids, *(torch.from_numpy(each).float() for each in noise)
        )
        if self.action_space == "discrete":
            outputs = outputs.softmax(dim=2)
        chunks: Floats = outputs.numpy()
        return chunks

    def _add(self, chunks: Floats, due: Mask) -> None:
        decay = getattr(self._settings, "ensemble", None)
        if decay is None:  # a new chunk replaces what is left of the one before
            self._weights[due], self._sums[due], self._counts[due] = 0, 0, 0
        weights = np.exp(-(decay or 0.0) * self._counts) * due[:, None]
        self._weights += weights
        self._sums += weights[:, :, None] * chunks
        self._counts += due[:, None]
