"""Diffusion policy: chunks of continuous actions, denoised from normal noise.

Source: Chi et al., "Diffusion policy: visuomotor policy learning via action diffusion", RSS 2023;
the sampler is DDIM's (Song et al., ICLR 2021), the schedule Nichol and Dhariwal's (ICML 2021). A
network predicts the noise in a chunk of demonstrated actions, given the frames; a policy starts
from noise, removes it in a few steps, and executes half of the chunk.

What differs: the encoder of images is one of this package's; the denoiser's residual blocks keep
the chunk's length instead of halving it, as chunks are short; the learning rate is annealed, where
the published weights are averaged.
"""

import math
from dataclasses import dataclass, field
from functools import partial

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.envs.action_spec import ActionSpaceName
from magical.learning.algorithms import Algorithm
from magical.learning.chunks import ACTION_SIZES, ChunkPolicy, ChunkSettings
from magical.learning.models import Trunk
from magical.learning.running.run import Run
from magical.learning.running.streams import seeded_init
from magical.learning.settings import POSITIVE, option
from magical.learning.supervised import (
    Chunks,
    SupervisedConfig,
    demonstrated,
    fit,
    masked_mean,
    sample_chunks,
)

SIZE = ACTION_SIZES["continuous"]
NOISE_LEVELS = 100  # T: of training
SCHEDULE_OFFSET = 0.008  # s of the cosine schedule
MAX_BETA = 0.999
CHANNELS, KERNEL, BLOCKS, GROUPS = 128, 5, 4, 8  # of the denoiser
LEVEL_FEATURES = 64  # sines and cosines of a noise level


@dataclass(frozen=True, kw_only=True)
class DiffusionConfig(SupervisedConfig):
    """Settings of diffusion policy."""

    algorithm: str = "diffusion"
    chunks: ChunkSettings = field(default_factory=partial(ChunkSettings, execute=8))
    denoising_steps: int = option(10, "steps of DDIM for a chunk", POSITIVE)

    @property
    def action_space(self) -> ActionSpaceName:
        """See `Config`."""
        return "continuous"


class DiffusionNetwork(nn.Module):
    """Images (B, C, H, W) in [0, 1], tasks (B,) and noise (B, K, 3) to chunks (B, K, 3)."""

    signal: Tensor  # (T,): the share of the actions in what is seen at each noise level

    def __init__(self, config: DiffusionConfig) -> None:
        super().__init__()
        self.noise_shape = config.chunks.chunk, SIZE
        self.steps = config.denoising_steps
        self.trunk = Trunk(config.networks.network, config.input_shape, batch_norm=True)
        self.task = nn.Embedding(len(config.tasks), self.trunk.num_features)
        self.denoiser = Denoiser(self.trunk.num_features)
        self.register_buffer("signal", cosine_schedule(NOISE_LEVELS), persistent=False)

    def features(self, images: Tensor, tasks: Tensor) -> Tensor:
        """What the denoiser is given: (B, features)."""
        features: Tensor = self.trunk(images) + self.task(tasks)
        return features

    def forward(self, images: Tensor, tasks: Tensor, noise: Tensor) -> Tensor:
        """Remove the noise in steps of DDIM."""
        given, chunks = self.features(images, tasks), noise
        levels = torch.linspace(NOISE_LEVELS - 1, 0, self.steps).round().long().tolist()
        for level, following in zip(levels, [*levels[1:], None], strict=True):
            numbers = torch.full((len(chunks),), level, device=chunks.device)
            found = self.denoiser(chunks, numbers, given).float()
            signal = self.signal[level]
            actions = (chunks - (1.0 - signal).sqrt() * found) / signal.sqrt()
            actions = actions.clamp(-1.0, 1.0)
            if following is None:
                return actions
            found = (chunks - signal.sqrt() * actions) / (1.0 - signal).sqrt()
            signal = self.signal[following]
            chunks = signal.sqrt() * actions + (1.0 - signal).sqrt() * found
        raise AssertionError("there is at least one step")


class Denoiser(nn.Module):
    """The noise (B, K, 3) in noisy chunks (B, K, 3), by their levels (B,) and features (B, F)."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.level = nn.Sequential(
            nn.Linear(LEVEL_FEATURES, CHANNELS), nn.Mish(), nn.Linear(CHANNELS, CHANNELS)
        )
        self.first = nn.Conv1d(SIZE, CHANNELS, KERNEL, padding=KERNEL // 2)
        self.blocks = nn.ModuleList(_Block(features + CHANNELS) for _ in range(BLOCKS))
        self.last = nn.Conv1d(CHANNELS, SIZE, 1)

    def forward(self, chunks: Tensor, levels: Tensor, features: Tensor) -> Tensor:
        """See above."""
        given = torch.cat([features, self.level(_waves(levels))], dim=1)
        hidden = self.first(chunks.mT)
        for block in self.blocks:
            hidden = block(hidden, given)
        noise: Tensor = self.last(hidden).mT
        return noise


class _Block(nn.Module):
    """Two convolutions over time; what is given scales and shifts the first one's output."""

    def __init__(self, given: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(), _convolution()
        self.scale_and_shift = nn.Linear(given, 2 * CHANNELS)

    def forward(self, hidden: Tensor, given: Tensor) -> Tensor:
        scale, shift = self.scale_and_shift(functional.mish(given))[:, :, None].chunk(2, dim=1)
        changed: Tensor = self.second(self.first(hidden) * (1.0 + scale) + shift)
        return hidden + changed


def _convolution() -> nn.Sequential:
    return nn.Sequential(
        nn.Conv1d(CHANNELS, CHANNELS, KERNEL, padding=KERNEL // 2),
        nn.GroupNorm(GROUPS, CHANNELS),
        nn.Mish(),
    )


def _waves(levels: Tensor) -> Tensor:
    """Sines and cosines (B, LEVEL_FEATURES) of levels (B,), of wavelengths up to 10,000."""
    half = LEVEL_FEATURES // 2
    rates = torch.exp(-math.log(10_000.0) * torch.arange(half, device=levels.device) / half)
    angles = levels[:, None] * rates
    return torch.cat([angles.sin(), angles.cos()], dim=1)


def cosine_schedule(levels: int) -> Tensor:
    """The share of the signal, alpha-bar of levels (T,), from nearly 1 to nearly 0."""
    times = (torch.arange(levels + 1).double() / levels + SCHEDULE_OFFSET) / (1 + SCHEDULE_OFFSET)
    shares = (times * math.pi / 2).cos().square()
    betas = (1.0 - shares[1:] / shares[:-1]).clamp(max=MAX_BETA)
    return (1.0 - betas).cumprod(dim=0).float()


def diffusion_losses(network: DiffusionNetwork, batch: Chunks) -> dict[str, Tensor]:
    """The loss to be minimised: the squared error of the predicted noise."""
    actions = batch.actions
    levels = torch.randint(NOISE_LEVELS, (len(actions),), device=actions.device)
    noise = torch.randn_like(actions)
    signal = network.signal[levels, None, None]
    noisy = signal.sqrt() * actions + (1.0 - signal).sqrt() * noise
    found = network.denoiser(noisy, levels, network.features(batch.images, batch.tasks)).float()
    return {"loss": masked_mean((found - noise).square().mean(dim=2), batch.exist)}


def train(config: DiffusionConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    network, data = make_policy(config), demonstrated(config, run)
    sample = partial(sample_chunks, config, data, config.chunks.chunk)
    fit(config, run, network, data, sample, partial(diffusion_losses, network))


def make_policy(config: DiffusionConfig) -> DiffusionNetwork:
    """The network, initialised from the seed."""
    with seeded_init(config.seed):
        return DiffusionNetwork(config)


ALGORITHM = Algorithm(DiffusionConfig, train, make_policy, ChunkPolicy)
