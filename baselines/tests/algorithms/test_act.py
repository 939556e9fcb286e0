"""Action chunking with transformers: its losses, and its style variable."""

import math
from typing import Any

import pytest
import torch
from torch import nn
from torch.distributions import Normal, kl_divergence

from baselines.tests.conftest import TASKS
from magical_baselines.algorithms import act
from magical_baselines.algorithms.act import ACTConfig, act_losses, make_policy
from magical_baselines.algorithms.chunks import Chunks

LENGTH = 4
SPACES = ("discrete", "continuous")


def config(**settings: Any) -> ACTConfig:
    made = {"tasks": TASKS, "demos": "", "chunk": LENGTH, **settings}
    return ACTConfig.preset("quick", **made)


def batch(space: str = "discrete") -> Chunks:
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(6, 12, 1, 1, generator=generator).expand(-1, -1, 96, 96)
    actions = torch.randint(18, (6, LENGTH), generator=generator)
    if space == "continuous":
        actions = torch.randint(-1, 2, (6, LENGTH, 3), generator=generator).float()
    exist = torch.ones(6, LENGTH, dtype=torch.bool)
    exist[2, 1:] = False
    return Chunks(images, actions, exist, ~exist, torch.arange(6) % len(TASKS))


def losses(network: act.ACTNetwork, samples: Chunks) -> dict[str, float]:
    torch.manual_seed(0)  # of z and of dropout
    found = act_losses(network, samples)
    return {name: value.item() for name, value in found.items()}


def test_the_divergence_is_that_of_normal_distributions() -> None:
    mean, log_variance = torch.randn(2, 5, 32, generator=torch.Generator().manual_seed(1))
    expected = kl_divergence(Normal(mean, (0.5 * log_variance).exp()), Normal(0.0, 1.0))
    torch.testing.assert_close(act.kl_divergence(mean, log_variance), expected.sum(dim=1))


def test_the_style_is_sampled_from_the_encoders_distribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network, samples = make_policy(config()), batch()
    mean, log_variance = torch.full((6, 32), 3.0), torch.full((6, 32), -2.0)
    monkeypatch.setattr(act.StyleEncoder, "forward", lambda *_: (mean, log_variance))
    seen: list[torch.Tensor] = []
    network.from_style.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    losses(network, samples)
    (z,) = seen
    assert z.mean().item() == pytest.approx(3.0, abs=0.1)
    assert z.std().item() == pytest.approx(math.exp(-1.0), rel=0.1)


@pytest.mark.parametrize("space", SPACES)
def test_what_is_beyond_the_end_does_not_count(space: str) -> None:
    network, samples = make_policy(config(action_space=space)), batch(space)
    padded, seen = samples.actions.clone(), samples.actions.clone()
    padded[2, 1:] = 0
    seen[2, :1] = 0
    before = losses(network, samples)
    assert losses(network, samples._replace(actions=padded)) == pytest.approx(before)
    assert losses(network, samples._replace(actions=seen)) != pytest.approx(before)
    assert before["loss"] == pytest.approx(before["action_loss"] + 10.0 * before["kl"])


@pytest.mark.parametrize(("space", "steps"), [("discrete", 50), ("continuous", 160)])
def test_chunks_are_overfitted_and_predicted_without_their_style(space: str, steps: int) -> None:
    network, samples = make_policy(config(action_space=space)), batch(space)
    network.trunk.convolutions = nn.Sequential(nn.AdaptiveAvgPool2d(6), nn.Conv2d(12, 64, 1))
    for parameter in network.shortcut.parameters():  # the transformers alone
        nn.init.zeros_(parameter.requires_grad_(False))
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3)
    for _ in range(steps):
        found = act_losses(network, samples)
        optimizer.zero_grad()
        torch.autograd.backward(found["loss"])
        optimizer.step()
    network.eval()
    with torch.no_grad():
        predicted = network(samples.images, samples.tasks)
    assert predicted.shape == (6, LENGTH, 18 if space == "discrete" else 3)
    if space == "discrete":
        right = predicted.argmax(dim=2) == samples.actions
    else:
        right = (predicted - samples.actions).abs().amax(dim=2) < 0.4
    assert right[samples.exist].float().mean() > 0.9


@pytest.mark.parametrize("space", SPACES)
def test_a_linear_layer_adds_to_the_chunk_what_behavioural_cloning_sees(space: str) -> None:
    network, samples = make_policy(config(action_space=space)).eval(), batch(space)
    with torch.no_grad():
        decoded = network(samples.images, samples.tasks)
        nn.init.zeros_(network.head.weight)
        nn.init.zeros_(network.head.bias)
        added = network(samples.images, samples.tasks)
        expected = network.shortcut(network.trunk(samples.images), samples.tasks)
    torch.testing.assert_close(added, expected.view(decoded.shape))
    assert not torch.allclose(added, decoded)


def test_without_its_style_a_chunk_is_that_of_z_0() -> None:
    samples = batch()
    with_style = make_policy(config()).eval()
    with torch.no_grad():
        plain, zero, one = (
            with_style(samples.images, samples.tasks, z)
            for z in (None, torch.zeros(6, act.LATENT_SIZE), torch.ones(6, act.LATENT_SIZE))
        )
    assert torch.equal(plain, zero)
    assert not torch.allclose(plain, one)


def test_tasks_share_a_network_that_tells_them_apart() -> None:
    network, samples = make_policy(config()).eval(), batch()
    with torch.no_grad():
        first, second = (network(samples.images, samples.tasks * 0 + task) for task in (0, 1))
    assert not torch.allclose(first, second)
