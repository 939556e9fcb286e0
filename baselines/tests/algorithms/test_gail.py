"""Adversarial imitation: losses by hand, rewards, whole runs of GAIL and WGAIL-GP."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import CPU, tiny
from magical.demos import Trajectory
from magical.errors import InvalidConfigError
from magical.observe import PRESETS
from magical_baselines.algorithms.gail import (
    DiscriminatorBatch,
    DiscriminatorTrainer,
    GAILConfig,
    RewardFn,
    gail_loss,
    gail_reward,
    make_discriminator,
)
from magical_baselines.algorithms.wgail_gp import (
    WGAILGPConfig,
    critic_loss,
    critic_reward,
    gradient_penalty,
    interpolate,
)
from magical_baselines.data.expert_data import ExpertData
from magical_baselines.reinforcement.replay_buffer import ROLLOUTS, ReplayBuffer


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
    penalty.backward()  # type: ignore[no-untyped-call]
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


def trainer(
    trajectories: list[Trajectory], reward: RewardFn = gail_reward
) -> tuple[DiscriminatorTrainer, ReplayBuffer]:
    sizes: dict[str, Any] = {"discriminator_learning_rate": 1e-3, "discriminator_batch_size": 12}
    config = tiny(GAILConfig, tasks=TASKS, augment="none", **sizes)
    expert = ExpertData(
        [(task, t) for task in TASKS for t in trajectories if task in t.env_id],
        TASKS,
        PRESETS["LoRes4E"],
    )
    replay_buffer = ReplayBuffer(2, np.array([0, 1]))
    subject = DiscriminatorTrainer(config, expert, replay_buffer, CPU, gail_loss, reward)
    return subject, replay_buffer


def novice(steps: int = 4) -> Any:
    rng = np.random.default_rng(1)
    images = rng.integers(0, 256, (steps, 2, 96, 96, 12), dtype=np.uint8)
    return SimpleNamespace(
        observations=torch.from_numpy(images).permute(0, 1, 4, 2, 3),  # the network's layout
        actions=torch.from_numpy(rng.integers(0, 18, (steps, 2))),
        rewards=torch.zeros(steps, 2),
        tasks=torch.tensor([0, 1]),
    )


@pytest.mark.parametrize(
    ("reward", "of_logits"),
    [(gail_reward, lambda logits: logits.sigmoid().log()), (critic_reward, lambda logits: logits)],
)
def test_rewards_are_the_evaluated_discriminators(
    reward: RewardFn, of_logits: RewardFn, trajectories: list[Trajectory]
) -> None:
    (subject, _), rollout = trainer(trajectories, reward), novice()
    before = {name: tensor.clone() for name, tensor in subject.network.state_dict().items()}
    rewards, statistics = subject.rewards(rollout)
    network = subject.network.eval()
    images = rollout.observations.flatten(0, 1) / 255.0
    with torch.no_grad():
        logits = network(images, rollout.actions.flatten(), torch.tensor([0, 1] * 4))
    raw = of_logits(logits).view(4, 2)
    assert statistics["raw_reward"] == pytest.approx(raw.mean().item(), abs=1e-5)
    scaled = (raw - raw.mean(dim=0)) / raw.std(dim=0, correction=0).clamp(min=1e-3) * 0.1
    np.testing.assert_allclose(rewards.numpy(), scaled.numpy(), atol=1e-3)
    assert all(torch.equal(before[name], now) for name, now in network.state_dict().items())


def test_batches_are_half_expert_half_novice(trajectories: list[Trajectory]) -> None:
    (subject, replay_buffer), rollout = trainer(trajectories), novice()
    replay_buffer.add(rollout.observations, rollout.actions)
    batch = subject.sample_batch(np.random.default_rng(0))
    assert batch.images.shape == (12, 12, 96, 96)
    assert batch.tasks.tolist() == [0, 0, 0, 1, 1, 1] * 2
    seen = rollout.observations.flatten(0, 1)
    ours = [bool((seen == image).flatten(1).all(dim=1).any()) for image in batch.images]
    assert ours == [False] * 6 + [True] * 6


def test_the_discriminator_is_trained(trajectories: list[Trajectory]) -> None:
    (subject, replay_buffer), rollout = trainer(trajectories), novice()
    replay_buffer.add(rollout.observations, rollout.actions)
    rng = np.random.default_rng(0)
    metrics = [subject.train(rng) for _ in range(22)]
    accuracies = [float(row["discriminator_accuracy"]) for row in metrics[1:21]]
    assert np.mean(accuracies) > 0.8
    assert float(metrics[21]["discriminator_loss"]) < float(metrics[0]["discriminator_loss"])


def test_presets_take_tasks_from_any_iterable() -> None:
    tasks = ("ClusterColour", "MoveToCorner")
    for preset, horizon in (("paper", "appendix"), ("published-code", "published")):
        config = GAILConfig.preset(preset, tasks=iter(tasks), demos="")
        assert (config.tasks, config.ppo.horizon) == (tasks, horizon)


def test_paper_s_rollouts_and_batch_norms() -> None:
    config = GAILConfig.preset("paper", tasks=("MoveToRegion",), demos="")
    norms = [m for m in make_discriminator(config).modules() if isinstance(m, nn.BatchNorm2d)]
    assert (ROLLOUTS, len(norms)) == (4, 5)


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"discriminator_batch_size": 5}, "discriminator_batch_size"),
        ({"discriminator_batch_size": 2, "tasks": TASKS}, "discriminator_batch_size"),
        ({"reward_std": 0.0}, "reward_std"),
        ({"num_demos": 0}, "num_demos"),
    ],
)
def test_impossible_settings(fields: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidConfigError, match=named):
        tiny(GAILConfig, **fields)


def test_wasserstein_gail_is_not_defined_for_several_tasks() -> None:
    with pytest.raises(InvalidConfigError, match="wgail-gp: expected one task"):
        tiny(WGAILGPConfig, tasks=TASKS)
