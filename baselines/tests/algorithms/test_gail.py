"""Adversarial imitation: losses by hand, rewards, batches of GAIL and WGAIL-GP."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import tiny
from magical.demos import Trajectory
from magical.observe import PRESETS
from magical_baselines.algorithms.gail import (
    DiscriminatorBatch,
    GAILConfig,
    gail_loss,
    gail_reward,
    make_discriminator,
    rollout_logits,
    sample_batch,
)
from magical_baselines.algorithms.wgail_gp import (
    critic_loss,
    critic_reward,
    gradient_penalty,
    interpolate,
)
from magical_baselines.data import ExpertData
from magical_baselines.replay import RecentRollouts
from magical_baselines.training import gradient_step


class Linear(nn.Module):
    """A discriminator whose logit is weight . image, times a factor for each action."""

    def __init__(self, size: int = 6) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.linspace(-1.0, 2.0, size))

    def forward(self, images: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        logits: Tensor = images.flatten(1) @ self.weight * (1.0 + actions)
        return logits


def batch_of(images: Tensor, actions: list[int]) -> DiscriminatorBatch:
    return DiscriminatorBatch(
        images, torch.tensor(actions), torch.zeros(len(actions), dtype=torch.int64)
    )


def given(logits: list[float]) -> Any:
    """A network that answers with these logits."""
    return lambda images, actions, tasks: torch.tensor(logits)


def test_discriminator_loss_by_hand() -> None:
    batch = batch_of(torch.zeros(4, 3, 1, 1), [0] * 4)
    answers = given([math.log(3.0), -1e-3, math.log(3.0), -20.0])  # expert, expert, novice, novice
    loss, report = gail_loss(answers, batch, np.random.default_rng(0))
    second = math.log(1 + math.exp(1e-3))  # -log sigmoid(-0.001)
    assert loss.item() == pytest.approx((math.log(4 / 3) + second + math.log(4)) / 4, abs=1e-6)
    assert report["discriminator_accuracy"].item() == 0.5


def test_gradient_penalty_against_finite_differences() -> None:
    torch.manual_seed(0)
    first, second = nn.Linear(12, 5).double(), nn.Linear(5, 1).double()

    def critic(images: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        logits: Tensor = second(torch.tanh(first(images.flatten(1)))).squeeze(1)
        return logits * (1.0 + actions)

    images = torch.randn(3, 3, 2, 2, dtype=torch.float64)
    actions, tasks = torch.tensor([0, 1, 2]), torch.zeros(3, dtype=torch.int64)
    step, norms = 1e-6, []
    for row in range(3):
        slopes = []
        for index in range(12):
            shift = torch.zeros(3, 12, dtype=torch.float64)
            shift[row, index] = step
            ahead, behind = (
                critic(images + sign * shift.view_as(images), actions, tasks)[row].item()
                for sign in (1, -1)
            )
            slopes.append((ahead - behind) / (2 * step))
        norms.append(math.hypot(*slopes))
    expected = np.mean([(norm - 1.0) ** 2 for norm in norms])
    penalty = gradient_penalty(critic, images, actions, tasks)
    assert penalty.item() == pytest.approx(expected, rel=1e-6)
    penalty.backward()
    assert first.weight.grad is not None
    assert first.weight.grad.abs().sum() > 0


def test_images_between_have_the_nearer_ones_action() -> None:
    half = 200
    images = torch.cat([torch.ones(half, 3, 1, 1), torch.zeros(half, 3, 1, 1)])
    batch = batch_of(images, [7] * half + [3] * half)
    between, actions, tasks = interpolate(batch, np.random.default_rng(0))
    shares = between[:, 0, 0, 0]  # expert's images are ones
    assert torch.equal(actions == 7, shares > 0.5)
    assert shares.min() < 0.05 < 0.95 < shares.max()
    assert between.flatten(1).std(dim=1).max() == 0
    assert len(tasks) == half


def test_critic_loss_by_hand() -> None:
    network: Any = Linear()
    network.trunk = SimpleNamespace(pixels=(0.0, 1.0))
    images = torch.stack([torch.full((6, 1, 1), value) for value in (1.0, 2.0, 0.0, 0.5)])
    batch = batch_of(images, [0, 0, 0, 0])
    total = 3.0  # of the weights: logits are 3, 6, 0, 1.5
    loss, report = critic_loss(network, batch, np.random.default_rng(0), penalty_weight=10.0)
    norm = torch.linspace(-1.0, 2.0, 6).norm().item()
    distance = (1.5 - 0.25) * total
    assert report["wasserstein_distance"].item() == pytest.approx(distance)
    assert report["gradient_penalty"].item() == pytest.approx((norm - 1) ** 2, rel=1e-5)
    assert report["discriminator_accuracy"].item() == 1.0
    assert loss.item() == pytest.approx(10.0 * (norm - 1) ** 2 - distance, rel=1e-5)
    assert network.training


def novice(steps: int = 4) -> Any:
    rng = np.random.default_rng(1)
    images = rng.integers(0, 256, (steps, 2, 96, 96, 12), dtype=np.uint8)
    return SimpleNamespace(
        observations=torch.from_numpy(images).permute(0, 1, 4, 2, 3),  # the network's layout
        actions=torch.from_numpy(rng.integers(0, 18, (steps, 2))),
        rewards=torch.zeros(steps, 2),
        tasks=torch.tensor([0, 1]),
    )


def test_logits_of_a_rollout_are_the_evaluated_discriminators() -> None:
    config, rollout = tiny(GAILConfig, tasks=TASKS), novice()
    network = make_discriminator(config)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    found = rollout_logits(network, rollout)
    assert network.training
    images = rollout.observations.flatten(0, 1) / 255.0
    with torch.no_grad():
        logits = network.eval()(images, rollout.actions.flatten(), torch.tensor([0, 1] * 4))
    torch.testing.assert_close(found, logits.view(4, 2))
    assert all(torch.equal(before[name], now) for name, now in network.state_dict().items())


def test_rewards_are_log_probabilities_of_gail_and_logits_of_wgail() -> None:
    logits = torch.tensor([-3.0, 0.5])
    torch.testing.assert_close(gail_reward(logits), logits.sigmoid().log())
    assert torch.equal(critic_reward(logits), logits)


def sources(trajectories: list[Trajectory]) -> tuple[ExpertData, RecentRollouts]:
    demonstrations = [(task, t) for task in TASKS for t in trajectories if task in t.env_id]
    rollouts, rollout = RecentRollouts(np.array([0, 1]), "cpu"), novice()
    rollouts.add(rollout.observations, rollout.actions)
    return ExpertData(demonstrations, TASKS, PRESETS["LoRes4E"]), rollouts


def test_batches_are_half_expert_half_novice(trajectories: list[Trajectory]) -> None:
    batch = sample_batch(*sources(trajectories), [3, 3], np.random.default_rng(0))
    assert batch.images.shape == (12, 12, 96, 96)
    assert batch.tasks.tolist() == [0, 0, 0, 1, 1, 1] * 2
    seen = novice().observations.flatten(0, 1)
    ours = [bool((seen == image).flatten(1).all(dim=1).any()) for image in batch.images]
    assert ours == [False] * 6 + [True] * 6


def test_a_discriminator_learns_to_tell_them_apart(trajectories: list[Trajectory]) -> None:
    network = make_discriminator(tiny(GAILConfig, tasks=TASKS))
    optimizer, rng = torch.optim.Adam(network.parameters(), 1e-3), np.random.default_rng(0)
    expert, rollouts = sources(trajectories)
    losses = []
    for _ in range(22):
        batch = sample_batch(expert, rollouts, [3, 3], rng)
        loss, report = gail_loss(network, batch._replace(images=batch.images / 255.0), rng)
        gradient_step(optimizer, loss)
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]
    assert report["discriminator_accuracy"] > 0.8


def test_paper_s_discriminator_has_batch_norm() -> None:
    config = GAILConfig.preset("paper", tasks=("MoveToRegion",), demos="")
    norms = [m for m in make_discriminator(config).modules() if isinstance(m, nn.BatchNorm2d)]
    assert len(norms) == 5
