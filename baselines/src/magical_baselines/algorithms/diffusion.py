"""Diffusion policy: chunks of continuous actions, denoised from normal noise.

Source: Chi et al., "Diffusion policy: visuomotor policy learning via action diffusion", RSS 2023;
the sampler is DDIM's (Song et al., ICLR 2021), the schedule Nichol and Dhariwal's (ICML 2021). A
network predicts a chunk of demonstrated actions from a noisy one, given the frames; a policy starts
from noise, removes it in a few steps, and executes the first half of the chunk (`quick`: one step).

What differs: the network predicts the actions instead of the noise in them (an option of the
published code), which takes fewer batches to learn; the image encoder is one of this package's
networks instead of a ResNet with a spatial softmax; the denoiser is smaller, and its residual
blocks keep the chunk's length instead of halving and doubling it, as chunks are short; instead of
averaging the weights for the policy, the learning rate is annealed to 0; the robot's state is not
an input. Beyond a demonstration's end, its last action is repeated and learned, as published: the
denoiser sees these steps, too.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.errors import InvalidConfigError
from magical_baselines.algorithms.cloning import (
    ACTION_SIZES,
    QUICK,
    ChunkConfig,
    ChunkPolicy,
    Chunks,
    fit_sequences,
    sample_chunks,
)
from magical_baselines.config import Algorithm, PositiveInt, option
from magical_baselines.models import Trunk
from magical_baselines.training import Run, seeded_init

ACTION_SIZE = ACTION_SIZES["continuous"]
NOISE_LEVELS = 100  # T, in training
SCHEDULE_OFFSET = 0.008  # s of the cosine schedule
MAX_BETA = 0.999
CHANNELS, KERNEL_SIZE, LAYERS, GROUPS = 64, 5, 4, 8  # of the denoiser
EMBEDDING_SIZE = 64  # of a noise level


@dataclass(frozen=True, kw_only=True)
class DiffusionConfig(ChunkConfig):
    """Settings of diffusion policy; those of `quick` score higher and take longer per action."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {**QUICK, "execute": 1, "denoising_steps": 3},
    }

    algorithm: str = "diffusion"
    execute: PositiveInt = option(8, "steps between predictions of chunks")
    denoising_steps: PositiveInt = option(10, "DDIM steps per chunk")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.denoising_steps > NOISE_LEVELS:
            raise InvalidConfigError(
                f"denoising_steps: expected at most the {NOISE_LEVELS} noise levels of training, "
                f"found {self.denoising_steps}"
            )

    @property
    def action_space(self) -> Literal["continuous"]:
        return "continuous"


class DiffusionNetwork(nn.Module):
    """Maps images (B, C, H, W) in [0, 1], tasks (B,) and noise (B, K, 3) to chunks (B, K, 3)."""

    alphas: Tensor  # (T,) cumulative products: the signal's share of the variance

    def __init__(self, config: DiffusionConfig) -> None:
        super().__init__()
        self.denoising_steps = config.denoising_steps
        self.trunk = Trunk(config.network, config.input_shape, batch_norm=True)
        self.task = nn.Embedding(len(config.tasks), self.trunk.num_features)
        self.denoiser = Denoiser(self.trunk.num_features)
        self.register_buffer("alphas", cosine_schedule(NOISE_LEVELS), persistent=False)

    def features(self, images: Tensor, tasks: Tensor) -> Tensor:
        """The features (B, F) that the denoiser is conditioned on."""
        features: Tensor = self.trunk(images) + self.task(tasks)
        return features

    def forward(self, images: Tensor, tasks: Tensor, noise: Tensor) -> Tensor:
        """Remove the noise in DDIM steps."""
        features, noisy = self.features(images, tasks), noise
        levels = torch.linspace(NOISE_LEVELS - 1, 0, self.denoising_steps).round().long()
        for step, level in enumerate(levels):
            predicted = self.denoiser(noisy, level.expand(len(noisy)), features)
            actions: Tensor = predicted.float().clamp(-1.0, 1.0)
            if step + 1 < len(levels):
                alpha, following = self.alphas[level], self.alphas[levels[step + 1]]
                noise = (noisy - alpha.sqrt() * actions) / (1.0 - alpha).sqrt()
                noisy = following.sqrt() * actions + (1.0 - following).sqrt() * noise
        return actions


class Denoiser(nn.Module):
    """Predicts chunks (B, K, 3) from noisy ones, their noise levels (B,) and features (B, F)."""

    def __init__(self, num_features: int) -> None:
        super().__init__()
        self.level = nn.Sequential(
            nn.Linear(EMBEDDING_SIZE, CHANNELS), nn.Mish(), nn.Linear(CHANNELS, CHANNELS)
        )
        self.first = nn.Conv1d(ACTION_SIZE, CHANNELS, KERNEL_SIZE, padding=KERNEL_SIZE // 2)
        self.blocks = nn.ModuleList(_ResidualLayer(num_features + CHANNELS) for _ in range(LAYERS))
        self.last = nn.Conv1d(CHANNELS, ACTION_SIZE, 1)

    def forward(self, noisy: Tensor, levels: Tensor, features: Tensor) -> Tensor:
        condition = torch.cat([features, self.level(_sinusoidal(levels, features))], dim=1)
        hidden = self.first(noisy.mT)
        for block in self.blocks:
            hidden = block(hidden, condition)
        chunks: Tensor = self.last(hidden).mT
        return chunks


class _ResidualLayer(nn.Module):
    """Two convolutions over time; the condition scales and shifts the first one's output (FiLM)."""

    def __init__(self, num_conditions: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(), _convolution()
        self.scale_and_shift = nn.Linear(num_conditions, 2 * CHANNELS)

    def forward(self, hidden: Tensor, condition: Tensor) -> Tensor:
        """Transform hidden features (B, CHANNELS, K)."""
        film = self.scale_and_shift(functional.mish(condition))[:, :, None]
        scale, shift = film.chunk(2, dim=1)
        change: Tensor = self.second(self.first(hidden) * (1.0 + scale) + shift)
        return hidden + change


def _convolution() -> nn.Sequential:
    return nn.Sequential(
        nn.Conv1d(CHANNELS, CHANNELS, KERNEL_SIZE, padding=KERNEL_SIZE // 2),
        nn.GroupNorm(GROUPS, CHANNELS),
        nn.Mish(),
    )


def _sinusoidal(levels: Tensor, like: Tensor) -> Tensor:
    """Sines and cosines (B, EMBEDDING_SIZE) of levels (B,), with periods up to 10,000 * 2 pi."""
    half = EMBEDDING_SIZE // 2
    rates = torch.exp(torch.arange(half, device=like.device) * (-math.log(10_000.0) / (half - 1)))
    angles = levels.to(like.device)[:, None] * rates
    return torch.cat([angles.sin(), angles.cos()], dim=1)


def cosine_schedule(levels: int) -> Tensor:
    """The signal's share of the variance at each noise level: (T,), from nearly 1 to nearly 0."""
    times = (torch.arange(levels + 1).double() / levels + SCHEDULE_OFFSET) / (1 + SCHEDULE_OFFSET)
    shares = (times * math.pi / 2).cos().square()
    betas = (1.0 - shares[1:] / shares[:-1]).clamp(max=MAX_BETA)
    return (1.0 - betas).cumprod(dim=0).float()


def diffusion_losses(network: DiffusionNetwork, batch: Chunks) -> dict[str, Tensor]:
    """The loss to be minimised: the mean squared error of the denoised actions.

    Actions that are repeated beyond a demonstration's end are learned, unknown ones are not.
    """
    actions = batch.actions
    levels = torch.randint(NOISE_LEVELS, (len(actions),), device=actions.device)
    noise = torch.randn_like(actions)
    alphas = network.alphas[levels, None, None]
    noisy = alphas.sqrt() * actions + (1.0 - alphas).sqrt() * noise
    features = network.features(batch.images, batch.tasks)
    predicted = network.denoiser(noisy, levels, features).float()
    known = (batch.exist | batch.padded)[..., None]
    return {"loss": functional.mse_loss(predicted, actions.where(known, predicted.detach()))}


class DiffusionPolicy(ChunkPolicy):
    """Samples a chunk by denoising noise from the rollout's own random stream."""

    config: DiffusionConfig

    def extra_inputs(self, count: int, rng: np.random.Generator) -> Sequence[Tensor]:
        noise = rng.standard_normal((count, self.config.chunk, ACTION_SIZE))
        return (torch.from_numpy(noise).float(),)


def train(config: DiffusionConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    fit_sequences(config, run, make_policy(config), sample_chunks, diffusion_losses)


def make_policy(config: DiffusionConfig) -> DiffusionNetwork:
    """The network, initialised from the seed."""
    with seeded_init(config.seed):
        return DiffusionNetwork(config)


ALGORITHM = Algorithm(DiffusionConfig, train, make_policy, DiffusionPolicy)
