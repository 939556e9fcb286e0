"""Diffusion policy: the schedule, the sampler, and that both belong together."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import CPU
from magical_baselines.algorithms import diffusion
from magical_baselines.algorithms.chunks import Chunks
from magical_baselines.algorithms.diffusion import (
    NOISE_LEVELS,
    DiffusionConfig,
    cosine_schedule,
    diffusion_losses,
    make_policy,
)

LENGTH = 4


def config(**settings: Any) -> DiffusionConfig:
    made = {"tasks": TASKS, "demos": "", "chunk": LENGTH, "execute": 2, **settings}
    return DiffusionConfig.preset("quick", **made)


def batch() -> Chunks:
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(3, 12, 1, 1, generator=generator).expand(-1, -1, 96, 96)
    actions = torch.randint(-1, 2, (3, LENGTH, 3), generator=generator).float()
    exist = torch.ones(3, LENGTH, dtype=torch.bool)
    exist[1, 2:] = False  # and yet they are learned
    return Chunks(images, actions, exist, ~exist, torch.arange(3) % len(TASKS))


def test_the_schedule_is_the_published_cosine_up_to_its_last_levels() -> None:
    """Nichol and Dhariwal, equation 17: f(t) / f(0) with s = 0.008, betas at most 0.999."""
    alphas = cosine_schedule(100).double().numpy()
    times = np.arange(1, 101) / 100
    f = np.cos((times + 0.008) / 1.008 * math.pi / 2) ** 2
    np.testing.assert_allclose(alphas[:-1], (f / math.cos(0.008 / 1.008 * math.pi / 2) ** 2)[:-1],
                               rtol=1e-4)  # fmt: skip
    assert 0.0 < alphas[-1] < 1e-5


class Counting(nn.Module):
    """A denoiser that is asked for known actions."""

    def __init__(self, actions: Tensor) -> None:
        super().__init__()
        self.actions, self.levels = actions, list[int]()

    def forward(self, noisy: Tensor, levels: Tensor, features: Tensor) -> Tensor:
        self.levels.append(int(levels[0]))
        self.seen = noisy, levels
        return self.actions


@pytest.mark.parametrize("steps", [1, 2, 10, NOISE_LEVELS])
def test_the_sampler_visits_so_many_levels_down_to_the_actions(steps: int) -> None:
    network, samples = make_policy(config(denoising_steps=steps)).eval(), batch()
    network.denoiser = counting = Counting(samples.actions)
    with torch.no_grad():
        found = network(samples.images, samples.tasks, torch.zeros(3, LENGTH, 3))
    assert torch.equal(found, samples.actions)
    assert len(set(counting.levels)) == steps
    assert counting.levels == sorted(counting.levels, reverse=True)
    assert (counting.levels[0], counting.levels[-1]) == (99, 0 if steps > 1 else 99)


def test_steps_between_follow_the_deterministic_sampler() -> None:
    """DDIM with eta = 0, as in equation 12 of Song et al., step by step."""
    network, samples = make_policy(config(denoising_steps=3)).eval(), batch()
    noise = torch.randn(3, LENGTH, 3, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found, noisy = network(samples.images, samples.tasks, noise), noise
        features = network.features(samples.images, samples.tasks)
        for level, following in ((99, 50), (50, 0), (0, None)):
            actions = network.denoiser(noisy, torch.full((3,), level), features).clamp(-1, 1)
            if following is not None:
                alpha, next_alpha = network.alphas[level], network.alphas[following]
                direction = (noisy - alpha**0.5 * actions) / (1 - alpha) ** 0.5
                noisy = next_alpha**0.5 * actions + (1 - next_alpha) ** 0.5 * direction
    torch.testing.assert_close(found, actions)


def test_training_adds_noise_of_all_levels_and_keeps_the_variance() -> None:
    network = make_policy(config())
    network.trunk = _Brightness()
    many = Chunks(*(each.repeat_interleave(300, dim=0) for each in batch()))
    network.denoiser = counting = Counting(many.actions + 0.5)
    torch.manual_seed(0)
    assert diffusion_losses(network, many)["loss"].item() == pytest.approx(0.25)
    noisy, levels = counting.seen
    assert set(levels.tolist()) == set(range(NOISE_LEVELS))
    alphas = network.alphas[levels, None, None]
    noise = (noisy - alphas.sqrt() * many.actions) / (1.0 - alphas).sqrt()
    assert noise.mean().item() == pytest.approx(0.0, abs=0.03)
    assert noise.std().item() == pytest.approx(1.0, abs=0.03)


def test_unknown_actions_are_not_learned() -> None:
    network = make_policy(config())
    network.trunk = _Brightness()
    unknown = batch()._replace(padded=torch.zeros(3, LENGTH, dtype=torch.bool))
    predicted = unknown.actions.clone().requires_grad_()
    network.denoiser = Counting(predicted + 0.5)
    torch.autograd.backward(diffusion_losses(network, unknown)["loss"])
    assert predicted.grad is not None
    assert torch.equal(predicted.grad != 0.0, unknown.exist[..., None].expand(-1, -1, 3))


class _Brightness(nn.Module):
    """Features of images that take no time."""

    def forward(self, images: Tensor) -> Tensor:
        return images[:, :, 0, 0].repeat(1, 22)[:, :256] * 4 - 2


def test_actions_are_overfitted_and_sampled() -> None:
    network, samples = make_policy(config()), batch()
    network.trunk = _Brightness()
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3)
    many = Chunks(*(each.repeat_interleave(16, dim=0) for each in samples))
    torch.manual_seed(0)
    for _ in range(120):
        loss = diffusion_losses(network, many)["loss"]
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
    network.eval()
    noise = torch.randn(3, LENGTH, 3, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found = network(samples.images, samples.tasks, noise)
    assert found.abs().max() <= 1.0
    assert (found - samples.actions).abs().max() < 0.3


def test_a_policy_denoises_each_rollouts_own_noise() -> None:
    policy = diffusion.DiffusionPolicy(make_policy(config()), config(), CPU)
    (noise,) = policy.extra_inputs(5, np.random.default_rng(0))
    assert noise.shape == (5, LENGTH, 3)
    assert noise.dtype == torch.float32
    expected = np.random.default_rng(0).standard_normal((5, LENGTH, 3))
    np.testing.assert_allclose(noise.numpy(), expected, rtol=1e-6)
