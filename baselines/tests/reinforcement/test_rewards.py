"""Reward normalisation, the replay buffer, and warnings of a collapse."""

from typing import Any

import numpy as np
import pytest
import torch

from magical_baselines.reinforcement.monitoring import (
    COLLAPSE_UPDATES,
    Monitor,
    mean_by_task,
)
from magical_baselines.reinforcement.replay_buffer import ReplayBuffer
from magical_baselines.reinforcement.reward_normalisation import FLOOR, RewardNormaliser


def test_rewards_are_normalised_as_two_passes_would() -> None:
    rng = np.random.default_rng(0)
    tasks = torch.tensor([0, 0, 0, 1, 1])
    normaliser = RewardNormaliser(2, std=0.1)
    history: list[np.ndarray[Any, Any]] = []
    for number in range(6):
        batch = rng.normal(1000.0 * number, 1.0 + number, (4, 5)).astype(np.float32)
        history.append(batch)
        found = normaliser(torch.from_numpy(batch), tasks)
        assert found.dtype == torch.float32
        for task in (0, 1):
            columns = tasks.numpy() == task
            so_far = np.concatenate(history)[:, columns].astype(np.float64)
            expected = (batch[:, columns] - so_far.mean()) / so_far.std() * 0.1
            np.testing.assert_allclose(found.numpy()[:, columns], expected, atol=1e-6)


def test_equal_rewards_are_not_blown_up() -> None:
    normaliser = RewardNormaliser(1, std=0.1)
    rewards = torch.tensor([[1.0, 1.0 + FLOOR / 10]])
    found = normaliser(rewards, torch.zeros(2, dtype=torch.int64))
    np.testing.assert_allclose(found.numpy(), [[-0.005, 0.005]], rtol=1e-3)


def test_a_task_without_environments_has_no_statistics() -> None:
    normaliser = RewardNormaliser(2, std=0.1)
    normaliser(torch.tensor([[1.0, 2.0]]), torch.tensor([1, 1]))
    assert normaliser.count.tolist() == [0, 2]
    assert normaliser.mean.tolist() == [0, 1.5]


def filled(batches: int) -> ReplayBuffer:
    """Rollouts of two steps of three environments, the last of another task; all values differ."""
    replay = ReplayBuffer(2, np.array([0, 0, 1]))
    for number in range(batches):
        observations = torch.arange(6).view(2, 3, 1) + 10 * number
        replay.add(observations.to(torch.uint8), observations.squeeze(2))
    return replay


@pytest.mark.parametrize(("batches", "kept"), [(1, {0}), (2, {0, 1}), (3, {1, 2})])
def test_novice_samples_come_from_the_last_batches(batches: int, kept: set[int]) -> None:
    shown, actions, tasks = filled(batches).sample([200, 200], np.random.default_rng(0))
    assert torch.equal(shown.squeeze(1).long(), actions)
    assert set((actions // 10).tolist()) == kept
    assert set((actions % 10).tolist()) == set(range(6))
    assert torch.equal(tasks, (actions % 10 % 3 == 2).long())
    assert tasks.sum() == 200  # evenly, though only one environment in three has this task


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_the_buffer_is_restored_from_its_state(dtype: torch.dtype) -> None:
    replay, other = (ReplayBuffer(2, np.array([0, 0, 1])) for _ in range(2))
    more = torch.arange(6).reshape(2, 3, 1)
    replay.add(more.to(dtype), more.squeeze(2))
    other.load_state_dict(replay.state_dict(), "cpu")
    for each in (replay, other):
        each.add(more.to(dtype), more.squeeze(2))
    first, second = (r.sample([30, 20], np.random.default_rng(1)) for r in (replay, other))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_flat_images_are_small_in_a_checkpoint() -> None:
    replay = ReplayBuffer(4, np.array([0]))
    replay.add(torch.zeros(8, 1, 96, 96, 12, dtype=torch.uint8), torch.zeros(8, 1).long())
    assert replay.state_dict()["observations"].numel() < 8 * 96 * 96 * 12 / 50


def monitored(one_action: bool) -> Monitor:
    monitor = Monitor()
    monitor.add_rollout(torch.tensor([[1, 1 if one_action else 0]]), ())
    return monitor


@pytest.mark.parametrize(
    ("metrics", "one_action", "warning"),
    [
        ({"discriminator_accuracy": 1.0}, False, "discriminator always right"),
        ({"discriminator_accuracy": 0.46}, False, "discriminator at chance"),
        ({}, True, "one action"),
    ],
)
def test_a_symptom_that_lasts_is_warned_of(
    metrics: dict[str, float | str], one_action: bool, warning: str
) -> None:
    monitor, again = monitored(one_action), monitored(one_action)
    for _ in range(COLLAPSE_UPDATES - 1):
        assert monitor.warning(metrics) == {}
    again.load_state_dict(monitor.state_dict())
    assert again.warning(metrics) == {"warning": f"{warning} for {COLLAPSE_UPDATES} updates"}
    again.add_rollout(torch.tensor([[0, 1]]), ())
    assert again.warning({"discriminator_accuracy": 0.8}) == {}
    again.add_rollout(torch.tensor([[1, 1 if one_action else 0]]), ())
    assert again.warning(metrics) == {}  # the count restarts


def test_the_score_is_the_mean_over_tasks() -> None:
    assert mean_by_task([(0, 1.0), (0, 1.0), (0, 1.0), (1, 0.0)]) == 0.5
