"""Behavioural cloning with memory: a causal transformer over the last observations and actions.

Source: Chen et al., "Decision transformer", NeurIPS 2021, without returns, and Dasari and Gupta,
"Transformers for one-shot visual imitation", CoRL 2020, without the demonstration. Each step is a
token: the features of its frame stack and, with `past_actions`, the action taken before. The loss
is the cross-entropy of the actions of all steps in a window.

A policy that sees its past actions may repeat them instead of looking (de Haan, Jayaraman and
Levine, "Causal confusion in imitation learning", NeurIPS 2019); without them it may still infer
them from frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from magical.evaluation.policy import Actions, Mask
from magical.learning.algorithms import Algorithm
from magical.learning.augmentation.names import parse_augmentations
from magical.learning.data.expert_data import ExpertData
from magical.learning.models import TaskLinear, Trunk
from magical.learning.policy import TrainedPolicy, choose_actions
from magical.learning.running.run import Run
from magical.learning.running.streams import Purpose, seeded_init, stream
from magical.learning.settings import POSITIVE, option
from magical.learning.supervised import (
    FittingSettings,
    SupervisedConfig,
    demonstrated,
    fit,
    masked_mean,
)
from magical.scene import NOOP, NUM_ACTIONS

WIDTH, HEADS, LAYERS, DROPOUT = 128, 4, 2, 0.1  # of the transformer
INIT_STD = 0.02  # of learnt positions


@dataclass(frozen=True, kw_only=True)
class TransformerBCConfig(SupervisedConfig):
    """Settings of behavioural cloning with memory."""

    algorithm: str = "transformer-bc"
    # Windows, each of many samples.
    fitting: FittingSettings = field(default_factory=partial(FittingSettings, batch_size=8))
    window: int = option(16, "steps that are remembered, the present one included", POSITIVE)
    past_actions: bool = option(True, "past actions are seen")

    @property
    def training_samples(self) -> int:
        """Every step of all windows."""
        return super().training_samples * self.window


class Windows(NamedTuple):
    """Consecutive steps of demonstrations, L each."""

    images: Tensor  # (B, L, C, H, W) float32 in [0, 1]
    before: Tensor  # (B, L) int64: the actions before the frames
    actions: Tensor  # (B, L) int64
    exist: Tensor  # (B, L) bool: false before a demonstration's start
    tasks: Tensor  # (B,) int64


class MemoryNetwork(nn.Module):
    """Windows of steps to logits (B, L, 18)."""

    def __init__(self, config: TransformerBCConfig) -> None:
        super().__init__()
        self.window = config.window
        self.trunk = Trunk(config.networks.network, config.input_shape, batch_norm=True)
        self.from_features = nn.Linear(self.trunk.num_features, WIDTH)
        self.before = nn.Embedding(NUM_ACTIONS, WIDTH) if config.past_actions else None
        self.positions = nn.Parameter(torch.randn(config.window, WIDTH) * INIT_STD)
        layer = nn.TransformerEncoderLayer(WIDTH, HEADS, 4 * WIDTH, DROPOUT, batch_first=True)
        self.transformer = nn.TransformerEncoder(layer, LAYERS, enable_nested_tensor=False)
        self.policy = TaskLinear(WIDTH, NUM_ACTIONS, len(config.tasks))

    def forward(self, images: Tensor, tasks: Tensor) -> Tensor:
        """Tokens (B, WIDTH) of images (B, C, H, W); the rest is `logits`."""
        tokens: Tensor = self.from_features(self.trunk(images))
        return tokens

    def logits(self, tokens: Tensor, before: Tensor, exist: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B, L, 18) of tokens (B, L, WIDTH), actions before and what exists (B, L)."""
        length = tokens.shape[1]
        seen = tokens + self.positions
        if self.before is not None:
            seen = seen + self.before(before)
        later = torch.ones(length, length, dtype=torch.bool, device=tokens.device).triu(1)
        hidden_steps = ~exist[:, None] & ~torch.eye(length, dtype=torch.bool, device=exist.device)
        mask = (later | hidden_steps).repeat_interleave(HEADS, dim=0)  # (B * heads, L, L)
        found = self.transformer(seen, mask=mask)
        rows = self.policy(found.flatten(0, 1), tasks.repeat_interleave(length))
        logits: Tensor = rows.view(*found.shape[:2], -1)
        return logits


class MemoryPolicy(TrainedPolicy):
    """Samples actions from the distribution of the newest step of its memory."""

    network: MemoryNetwork
    _tokens: Tensor  # (B, L, WIDTH), the newest last
    _before: Tensor  # (B, L)
    _exist: Tensor  # (B, L)
    _last: NDArray[np.int64]  # (B,): the newest actions

    def reset(self, mask: Mask) -> None:
        """Forget the steps of the environments in which an episode starts."""
        count, length = len(mask), self.network.window
        if mask.all():
            self._tokens = torch.zeros(count, length, WIDTH, dtype=torch.float64)
            self._before = torch.zeros(count, length, dtype=torch.int64)
            self._exist = torch.zeros(count, length, dtype=torch.bool)
            self._last = np.full(count, NOOP)
        self._exist[torch.from_numpy(mask)] = False
        self._last[mask] = NOOP

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """See `TrainedPolicy`."""
        newest = self.outputs(observations, env_ids)
        last = torch.from_numpy(self._last)
        self._tokens = torch.cat([self._tokens[:, 1:], newest[:, None]], dim=1)
        self._before = torch.cat([self._before[:, 1:], last[:, None]], dim=1)
        self._exist = functional.pad(self._exist[:, 1:], (0, 1), value=True)
        tasks = self._task_numbers(env_ids)
        device = self._compute.device
        remembered = (self._tokens.float(), self._before, self._exist, tasks)
        with torch.inference_mode():
            logits = self.network.logits(*(each.to(device) for each in remembered))[:, -1]
        probabilities = logits.double().softmax(dim=1).cpu().numpy()
        self._last = choose_actions(probabilities, rng, self.greedy)
        return self._last


def sample_windows(config: TransformerBCConfig, data: ExpertData, number: int) -> Windows:
    """Batch `number`: windows that end at sampled steps, each augmented in one way."""
    rng = stream(config.seed, Purpose.BATCHES, number)
    ends = data.sample(config.fitting.batch_size, rng)
    rows, exist = data.neighbours(ends, np.arange(1 - config.window, 1))
    augmentations = parse_augmentations(config.fitting.augment)
    images = data.augmented(rows.ravel(), augmentations, rng, together=config.window)
    actions, tasks = data.labels(rows)
    previous, has_previous = data.neighbours(rows.ravel(), np.array([-1]))
    before, _ = data.labels(previous[:, 0])
    before[torch.from_numpy(~has_previous[:, 0]).to(before.device)] = NOOP
    return Windows(
        images.unflatten(0, rows.shape),
        before.view(actions.shape),
        actions,
        torch.from_numpy(exist).to(data.device),
        tasks[:, -1],
    )


def memory_losses(network: MemoryNetwork, batch: Windows) -> dict[str, Tensor]:
    """The loss to be minimised, the mean cross-entropy, and the accuracy of the newest step."""
    images = batch.images.flatten(0, 1).contiguous(memory_format=torch.channels_last)
    tokens = network(images, batch.tasks).view(*batch.actions.shape, -1)
    logits = network.logits(tokens, batch.before, batch.exist, batch.tasks).float()
    errors = functional.cross_entropy(logits.mT, batch.actions, reduction="none")
    newest = logits[:, -1].argmax(dim=1) == batch.actions[:, -1]
    return {"loss": masked_mean(errors, batch.exist), "accuracy": newest.float().mean()}


def train(config: TransformerBCConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    network, data = make_policy(config), demonstrated(config, run)
    sample = partial(sample_windows, config, data)
    fit(config, run, network, data, sample, partial(memory_losses, network))


def make_policy(config: TransformerBCConfig) -> MemoryNetwork:
    """The network, initialised from the seed."""
    with seeded_init(config.seed):
        return MemoryNetwork(config)


ALGORITHM = Algorithm(TransformerBCConfig, train, make_policy, MemoryPolicy)
