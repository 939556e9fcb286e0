"""Action chunking with transformers (ACT): several actions at once, from an encoder and a decoder.

Source: Zhao et al., "Learning fine-grained bimanual manipulation with low-cost hardware", RSS 2023.
A transformer encoder attends over the places of a convolutional feature map, the task and a latent
style; a decoder turns one query a step into a chunk of actions. In training, a conditional
variational autoencoder infers the style from the demonstrated chunk; afterwards it is 0. Chunks
that overlap are averaged (temporal ensembling).

What differs: the encoder of images is one of this package's and is trained from scratch; there are
two layers instead of four and seven, 128 features instead of 512; the learning rate is annealed;
the state of the robot is not given. Discrete actions are predicted by logits and cross-entropy,
continuous ones by the L1 loss as published.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.envs.action_spec import ActionSpaceName
from magical.learning.algorithms import Algorithm
from magical.learning.chunks import ACTION_SIZES, ChunkPolicy, EnsembleSettings
from magical.learning.networks import find_network
from magical.learning.running.run import Run
from magical.learning.running.streams import seeded_init
from magical.learning.settings import NOT_NEGATIVE, option
from magical.learning.supervised import (
    Chunks,
    SupervisedConfig,
    demonstrated,
    fit,
    masked_mean,
    sample_chunks,
)

WIDTH, HEADS, LAYERS, DROPOUT = 128, 4, 2, 0.1  # of all three transformers
LATENT = 32  # size of the style
INIT_STD = 0.02  # of learnt positions and queries


@dataclass(frozen=True, kw_only=True)
class ACTConfig(SupervisedConfig):
    """Settings of action chunking with transformers."""

    algorithm: str = "act"
    chunks: EnsembleSettings = field(default_factory=EnsembleSettings)
    actions: str = option(
        "discrete", "what is predicted", choices=("discrete", "continuous"), name="action_space"
    )
    kl_weight: float = option(
        10.0,
        "weight of the style's divergence from a normal distribution; 0: no style",
        NOT_NEGATIVE,
    )

    @property
    def action_space(self) -> ActionSpaceName:
        """See `Config`."""
        return cast(ActionSpaceName, self.actions)


class ACTNetwork(nn.Module):
    """Images (B, C, H, W) in [0, 1] and tasks (B,) to chunks (B, K, D)."""

    def __init__(self, config: ACTConfig) -> None:
        super().__init__()
        architecture = find_network(config.networks.network)
        self.convolutions = architecture.make_convolutions(config.input_shape[0], batch_norm=True)
        channels, places = _map_size(self.convolutions, config.input_shape)
        size, length = ACTION_SIZES[config.action_space], config.chunks.chunk
        self.from_map = nn.Linear(channels, WIDTH)
        self.places = _learnt(places, WIDTH)
        self.task = nn.Embedding(len(config.tasks), WIDTH)
        self.encoder = nn.TransformerEncoder(_layer(), LAYERS)
        self.queries = _learnt(length, WIDTH)
        self.decoder = nn.TransformerDecoder(_layer(nn.TransformerDecoderLayer), LAYERS)
        self.last = nn.Linear(WIDTH, size)
        self.style = Style(size, length) if config.kl_weight else None

    def forward(self, images: Tensor, tasks: Tensor, style: Tensor | None = None) -> Tensor:
        """Chunks, of the style (B, WIDTH) given or of the mean one."""
        features = self.convolutions(images).flatten(2).transpose(1, 2)  # (B, places, channels)
        tokens = [self.from_map(features) + self.places, self.task(tasks)[:, None]]
        if self.style is not None:
            given = self.style.embed(images.new_zeros(len(images), LATENT))
            tokens.append((given if style is None else style)[:, None])
        seen = self.encoder(torch.cat(tokens, dim=1))
        queries = self.queries.expand(len(images), -1, -1)
        chunks: Tensor = self.last(self.decoder(queries, seen))
        return chunks


class Style(nn.Module):
    """The style of a demonstrated chunk, as the encoder of a variational autoencoder infers it."""

    def __init__(self, size: int, length: int) -> None:
        super().__init__()
        self.size = size
        self.from_action = nn.Linear(size, WIDTH)
        self.summary = _learnt(1, WIDTH)
        self.steps = _learnt(length, WIDTH)
        self.encoder = nn.TransformerEncoder(_layer(), LAYERS)
        self.moments = nn.Linear(WIDTH, 2 * LATENT)
        self.embed = nn.Linear(LATENT, WIDTH)

    def forward(self, batch: Chunks) -> tuple[Tensor, Tensor]:
        """A sampled style (B, WIDTH) and its mean divergence from a normal distribution."""
        actions = batch.actions
        if not actions.is_floating_point():
            actions = functional.one_hot(actions, self.size)
        tokens = self.from_action(actions.float()) + self.steps
        summary = self.summary.expand(len(tokens), -1, -1)
        beyond = functional.pad(~batch.exist, (1, 0))  # the summary attends to what exists
        seen = self.encoder(torch.cat([summary, tokens], dim=1), src_key_padding_mask=beyond)
        mean, log_variance = self.moments(seen[:, 0]).float().chunk(2, dim=1)
        sampled = mean + torch.randn_like(mean) * (0.5 * log_variance).exp()
        divergence = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(dim=1)
        return self.embed(sampled), divergence.mean()


def act_losses(network: ACTNetwork, kl_weight: float, batch: Chunks) -> dict[str, Tensor]:
    """The loss to be minimised, and its parts: of the actions that exist, and the divergence."""
    style, divergence = None, torch.zeros(())
    if network.style is not None:
        style, divergence = network.style(batch)
    predicted = network(batch.images, batch.tasks, style).float()  # (B, K, D)
    if batch.actions.is_floating_point():
        errors = (predicted - batch.actions).abs().mean(dim=2)
    else:
        errors = functional.cross_entropy(predicted.mT, batch.actions, reduction="none")
    action_loss = masked_mean(errors, batch.exist)
    loss = action_loss + kl_weight * divergence
    return {"loss": loss, "action_loss": action_loss, "divergence": divergence}


def train(config: ACTConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    network, data = make_policy(config), demonstrated(config, run)
    sample = partial(sample_chunks, config, data, config.chunks.chunk)
    fit(config, run, network, data, sample, partial(act_losses, network, config.kl_weight))


def make_policy(config: ACTConfig) -> ACTNetwork:
    """The network, initialised from the seed."""
    with seeded_init(config.seed):
        return ACTNetwork(config)


def _layer(kind: type[nn.Module] = nn.TransformerEncoderLayer) -> nn.Module:
    return kind(WIDTH, HEADS, 4 * WIDTH, DROPOUT, batch_first=True)


def _learnt(count: int, size: int) -> nn.Parameter:
    return nn.Parameter(torch.randn(count, size) * INIT_STD)


def _map_size(convolutions: nn.Module, input_shape: tuple[int, ...]) -> tuple[int, int]:
    """Channels and places of a feature map."""
    convolutions.eval()  # leaves the statistics of batch norm alone
    with torch.no_grad():
        _, channels, height, width = convolutions(torch.zeros(1, *input_shape)).shape
    convolutions.train()
    return int(channels), int(height * width)


ALGORITHM = Algorithm(ACTConfig, train, make_policy, ChunkPolicy)
