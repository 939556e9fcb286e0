"""Action chunking with transformers (ACT): a transformer predicts several actions at once.

Source: Zhao et al., "Learning fine-grained bimanual manipulation with low-cost hardware", RSS 2023.
An encoder attends over the positions of a convolutional feature map, the task and a style variable
z; a decoder turns one query for each step into a chunk of actions. In training, z is sampled by the
encoder of a conditional variational autoencoder, which sees the demonstrated chunk; a policy acts
with z = 0. All chunks that predict a step are averaged (temporal ensembling).

What differs: the convolutions are from one of this package's networks, trained from scratch,
instead of a pre-trained ResNet; a linear layer on that network's features, as in behavioural
cloning, is added to the chunk, without which the transformers learn too slowly; they are smaller
(2 layers in the encoder and 1 in the others instead of 4 and 7, 64 features instead of 512) and
normalise before each layer instead of after it; positions are learnt; neither network sees the
robot's state; the learning rate is annealed to 0. Discrete actions are predicted as logits and
trained with the cross-entropy, continuous ones with the L1 loss, as published.

The published actions are joint positions, whose mean lies between them. The actions of this
benchmark are like velocities: drive, turn, grip. If chunks disagree about when the robot should
turn, the mean of their predictions is never right, so `quick` has no temporal ensembling.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical_baselines.algorithms.cloning import (
    ACTION_SIZES,
    QUICK,
    ChunkConfig,
    ChunkPolicy,
    Chunks,
    fit_sequences,
    masked_mean,
    sample_chunks,
)
from magical_baselines.config import Algorithm, option
from magical_baselines.models import TaskLinear, Trunk
from magical_baselines.training import Run, seeded_init

WIDTH, FEEDFORWARD, HEADS, DROPOUT = 64, 256, 4, 0.1  # of all three transformers
LAYERS = {"encoder": 2, "decoder": 1, "style": 1}
LATENT_SIZE = 32  # of z, as published
KL_WEIGHT = 10.0  # of the KL divergence of z from N(0, 1)
ENSEMBLE_DECAY = 0.01  # m: the n-th chunk that predicts a step has weight exp(-m n)


@dataclass(frozen=True, kw_only=True)
class ACTConfig(ChunkConfig):
    """Settings of action chunking with transformers."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {**QUICK, "batch_size": 16, "learning_rate": 1e-3, "ensemble": False},
    }

    algorithm: str = "act"
    action_space: Literal["discrete", "continuous"] = option(
        "discrete", "action space of the predictions"
    )
    ensemble: bool = option(True, "average the chunks that predict a step (temporal ensembling)")


class ACTNetwork(nn.Module):
    """Maps images (B, C, H, W) in [0, 1] and tasks (B,) to chunks (B, K, D)."""

    def __init__(self, config: ACTConfig) -> None:
        super().__init__()
        self.trunk = Trunk(config.network, config.input_shape, batch_norm=True)
        channels, *positions = self.trunk.map_shape
        action_size, length = ACTION_SIZES[config.action_space], config.chunk
        self.projection = nn.Linear(channels, WIDTH)
        self.positions = _learnt(math.prod(positions))
        self.task = nn.Embedding(len(config.tasks), WIDTH)
        self.encoder = _encoder(LAYERS["encoder"])
        self.queries = _learnt(length)
        layer = nn.TransformerDecoderLayer(
            WIDTH, HEADS, FEEDFORWARD, DROPOUT, batch_first=True, norm_first=True
        )
        self.decoder = nn.TransformerDecoder(layer, LAYERS["decoder"], nn.LayerNorm(WIDTH))
        self.head = nn.Linear(WIDTH, action_size)
        self.shortcut = TaskLinear(self.trunk.num_features, length * action_size, len(config.tasks))
        self.style = StyleEncoder(action_size, length)
        self.from_style = nn.Linear(LATENT_SIZE, WIDTH)

    def forward(self, images: Tensor, tasks: Tensor, z: Tensor | None = None) -> Tensor:
        """Predict chunks, given the style variable z (B, LATENT_SIZE), by default 0."""
        feature_map = self.trunk.feature_map(images)
        positions = feature_map.reshape(len(images), self.trunk.map_shape[0], -1).mT  # (B, P, C)
        z = images.new_zeros(len(images), LATENT_SIZE) if z is None else z
        others = [each[:, None] for each in (self.task(tasks), self.from_style(z))]
        tokens = torch.cat([self.projection(positions) + self.positions, *others], dim=1)
        memory = self.encoder(tokens)
        decoded = self.head(self.decoder(self.queries.expand(len(images), -1, -1), memory))
        features = self.trunk.linear(feature_map.flatten(1))
        chunks: Tensor = decoded + self.shortcut(features, tasks).view(decoded.shape)
        return chunks


class StyleEncoder(nn.Module):
    """Predicts mean and log-variance (B, LATENT_SIZE) of z from the demonstrated chunk."""

    def __init__(self, action_size: int, length: int) -> None:
        super().__init__()
        self.action_size = action_size
        self.projection = nn.Linear(action_size, WIDTH)
        self.summary = _learnt(1)  # the CLS token, whose output is used
        self.positions = _learnt(length)
        self.encoder = _encoder(LAYERS["style"])
        self.moments = nn.Linear(WIDTH, 2 * LATENT_SIZE)

    def forward(self, batch: Chunks) -> tuple[Tensor, Tensor]:
        actions = batch.actions
        if not actions.is_floating_point():
            actions = functional.one_hot(actions, self.action_size).float()
        tokens = self.projection(actions) + self.positions
        summary = self.summary.expand(len(tokens), -1, -1)
        padding = functional.pad(~batch.exist, (1, 0))  # the summary is never padding
        encoded = self.encoder(torch.cat([summary, tokens], dim=1), src_key_padding_mask=padding)
        mean, log_variance = self.moments(encoded[:, 0]).float().chunk(2, dim=1)
        return mean, log_variance


def act_losses(network: ACTNetwork, batch: Chunks) -> dict[str, Tensor]:
    """The loss to be minimised and its two parts, for the actions that exist and for z."""
    mean, log_variance = network.style(batch)
    z = mean + (0.5 * log_variance).exp() * torch.randn_like(mean)
    kl = kl_divergence(mean, log_variance).mean()
    predicted = network(batch.images, batch.tasks, z).float()  # (B, K, D)
    if batch.actions.is_floating_point():
        errors = (predicted - batch.actions).abs().mean(dim=2)
    else:
        errors = functional.cross_entropy(predicted.mT, batch.actions, reduction="none")
    action_loss = masked_mean(errors, batch.exist)
    return {"loss": action_loss + KL_WEIGHT * kl, "action_loss": action_loss, "kl": kl}


def kl_divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL divergence (B,) of diagonal normal distributions (B, size) from N(0, 1)."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(dim=1)


class ACTPolicy(ChunkPolicy):
    """Averages the predictions of all chunks if temporal ensembling is on."""

    config: ACTConfig

    @property
    def ensemble_decay(self) -> float | None:
        return ENSEMBLE_DECAY if self.config.ensemble else None


def train(config: ACTConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    fit_sequences(config, run, make_policy(config), sample_chunks, act_losses)


def make_policy(config: ACTConfig) -> ACTNetwork:
    """The network, initialised from the seed."""
    with seeded_init(config.seed):
        return ACTNetwork(config)


def _encoder(layers: int) -> nn.TransformerEncoder:
    layer = nn.TransformerEncoderLayer(
        WIDTH, HEADS, FEEDFORWARD, DROPOUT, batch_first=True, norm_first=True
    )
    return nn.TransformerEncoder(layer, layers, nn.LayerNorm(WIDTH), enable_nested_tensor=False)


def _learnt(count: int) -> nn.Parameter:
    """Learnt positions or queries, initialised like the published code's embeddings."""
    return nn.Parameter(torch.randn(count, WIDTH))


ALGORITHM = Algorithm(ACTConfig, train, make_policy, ACTPolicy)
