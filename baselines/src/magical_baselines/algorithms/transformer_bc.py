"""Behavioural cloning with memory: a causal transformer over past observations and actions.

Source: Chen et al., "Decision transformer: reinforcement learning via sequence modeling", NeurIPS
2021, without returns. The loss is the cross-entropy of the actions of all steps in a window.

What differs: a step is one token, the sum of the features of its frame stack and, with
`past_actions`, an embedding of the previous action, instead of two tokens; the image encoder is one
of this package's networks; there are 2 layers. A window holds consecutive samples, so if no-ops
have been left out, the previous action is the last one that was not a no-op.

A policy that sees its past actions may repeat them instead of looking (de Haan, Jayaraman and
Levine, "Causal confusion in imitation learning", NeurIPS 2019); without them, it may still infer
them from the frames.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from magical.evaluation.policy import Actions, Mask
from magical.scene import NOOP, NUM_ACTIONS
from magical_baselines.algorithms.cloning import QUICK, SequenceConfig, fit_sequences, masked_mean
from magical_baselines.augmentation.augment import augment
from magical_baselines.config import Algorithm, PositiveInt, option
from magical_baselines.data import ExpertData
from magical_baselines.models import TaskLinear, Trunk
from magical_baselines.policy import TrainedPolicy, choose_actions
from magical_baselines.training import Run, seeded_init

WIDTH, HEADS, LAYERS, DROPOUT = 128, 4, 2, 0.1  # of the transformer
INIT_STD = 0.02  # of learnt positions


@dataclass(frozen=True, kw_only=True)
class TransformerBCConfig(SequenceConfig):
    """Settings of behavioural cloning with memory; a batch is of `batch_size` windows."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {**QUICK, "batch_size": 4, "learning_rate": 1e-3},
    }

    algorithm: str = "transformer-bc"
    batch_size: PositiveInt = option(8, "windows per batch")
    window: PositiveInt = option(16, "steps in the input, the current one included")
    past_actions: bool = option(True, "include past actions in the input")


class Windows(NamedTuple):
    """Windows of L consecutive samples of demonstrations."""

    images: Tensor  # (B, L, C, H, W) float32 in [0, 1]
    before: Tensor  # (B, L) int64: the actions executed before the observations
    actions: Tensor  # (B, L) int64
    exist: Tensor  # (B, L) bool: false before a demonstration's start
    tasks: Tensor  # (B,) int64


class MemoryNetwork(nn.Module):
    """Maps windows of observations and actions to logits, in two parts.

    `forward` turns images (B, C, H, W) into tokens (B, WIDTH), which a policy can keep from step to
    step, and `logits` turns tokens into logits.
    """

    def __init__(self, config: TransformerBCConfig) -> None:
        super().__init__()
        self.trunk = Trunk(config.network, config.input_shape, batch_norm=True)
        self.projection = nn.Linear(self.trunk.num_features, WIDTH)
        self.before = nn.Embedding(NUM_ACTIONS, WIDTH) if config.past_actions else None
        self.positions = nn.Parameter(torch.randn(config.window, WIDTH) * INIT_STD)
        layer = nn.TransformerEncoderLayer(
            WIDTH, HEADS, 4 * WIDTH, DROPOUT, batch_first=True, norm_first=True
        )
        self.transformer = nn.TransformerEncoder(
            layer, LAYERS, nn.LayerNorm(WIDTH), enable_nested_tensor=False
        )
        self.policy = TaskLinear(WIDTH, NUM_ACTIONS, len(config.tasks))

    def forward(self, images: Tensor, tasks: Tensor) -> Tensor:
        """Tokens, which do not depend on the tasks."""
        tokens: Tensor = self.projection(self.trunk(images))
        return tokens

    def logits(self, tokens: Tensor, before: Tensor, exist: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B, L, 18), given tokens (B, L, WIDTH); `before` and `exist` as in `Windows`."""
        length = tokens.shape[1]
        hidden = tokens + self.positions
        if self.before is not None:
            hidden = hidden + self.before(before)
        later = torch.ones(length, length, dtype=torch.bool, device=tokens.device).triu(1)
        itself = torch.eye(length, dtype=torch.bool, device=tokens.device)
        # A step sees itself even if it does not exist: attention to no steps at all would be NaN.
        unseen = later | ~(exist[:, None] | itself)  # (B, L, L)
        hidden = self.transformer(hidden, mask=unseen.repeat_interleave(HEADS, dim=0))
        logits: Tensor = self.policy(hidden.flatten(0, 1), tasks.repeat_interleave(length))
        return logits.view(*exist.shape, -1)


class MemoryPolicy(TrainedPolicy):
    """Samples actions from the distribution at the newest step of a window."""

    network: MemoryNetwork
    config: TransformerBCConfig
    _tokens: Tensor  # (B, L, WIDTH), the newest last
    _before: Tensor  # (B, L)
    _exist: Tensor  # (B, L)
    _last: NDArray[np.int64]  # (B,) the actions that were chosen last

    def reset(self, mask: Mask) -> None:
        """Clear the windows of the environments in which an episode starts."""
        if mask.all():
            shape = len(mask), self.config.window
            self._tokens = torch.zeros(*shape, WIDTH)
            self._before = torch.full(shape, NOOP)
            self._exist = torch.zeros(shape, dtype=torch.bool)
            self._last = np.full(len(mask), NOOP)
        self._exist[torch.from_numpy(mask)] = False
        self._last = np.where(mask, NOOP, self._last)

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        newest = self.outputs(observations, env_ids).float()
        before = torch.from_numpy(self._last)
        self._tokens = torch.cat([self._tokens[:, 1:], newest[:, None]], dim=1)
        self._before = torch.cat([self._before[:, 1:], before[:, None]], dim=1)
        self._exist = functional.pad(self._exist[:, 1:], (0, 1), value=True)
        window = (self._tokens, self._before, self._exist, self.task_numbers(env_ids))
        logits = self.computed(self.network.logits, *window)[:, -1]
        self._last = choose_actions(logits.softmax(dim=1).numpy(), rng, self.greedy)
        return self._last


def sample_windows(
    config: TransformerBCConfig, data: ExpertData, rng: np.random.Generator
) -> Windows:
    """Sample windows that end at sampled steps, each with a single augmentation."""
    ends = data.sample(config.batch_size, rng)
    rows, exist = data.neighbours(ends, np.arange(1 - config.window, 1))
    names = config.augmentations(config.augment)
    images = augment(data.images(rows.ravel()), names, rng, together=config.window)
    actions, tasks = data.labels(rows)
    previous, has_previous = data.neighbours(rows.ravel(), np.array([-1]))
    before = data.executed[torch.from_numpy(previous[:, 0]).to(data.device)]
    before[torch.from_numpy(~has_previous[:, 0]).to(before.device)] = NOOP
    return Windows(
        images.view(*rows.shape, *images.shape[1:]),
        before.view(actions.shape),
        actions,
        torch.from_numpy(exist).to(data.device),
        tasks[:, -1],
    )


def memory_losses(network: MemoryNetwork, batch: Windows) -> dict[str, Tensor]:
    """The loss to be minimised (the mean cross-entropy), and the accuracy at the newest step."""
    images = batch.images.flatten(0, 1).contiguous(memory_format=torch.channels_last)
    tokens = network(images, batch.tasks).view(*batch.actions.shape, -1)
    logits = network.logits(tokens, batch.before, batch.exist, batch.tasks).float()
    errors = functional.cross_entropy(logits.mT, batch.actions, reduction="none")
    accurate = logits[:, -1].argmax(dim=1) == batch.actions[:, -1]
    return {"loss": masked_mean(errors, batch.exist), "accuracy": accurate.float().mean()}


def train(config: TransformerBCConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    fit_sequences(config, run, make_policy(config), sample_windows, memory_losses)


def make_policy(config: TransformerBCConfig) -> MemoryNetwork:
    """The network, initialised from the seed."""
    with seeded_init(config.seed):
        return MemoryNetwork(config)


ALGORITHM = Algorithm(TransformerBCConfig, train, make_policy, MemoryPolicy)
