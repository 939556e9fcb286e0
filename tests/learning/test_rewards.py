"""What learned rewards pass through: running statistics, the store of novice samples, warnings."""

from typing import Any

import numpy as np
import pytest
import torch

from magical.learning.collapse import PATIENCE, Watch
from magical.learning.replay import Replay
from magical.learning.reward_normalisation import SMALLEST_DIVISOR, RewardNormaliser


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
    rewards = torch.tensor([[1.0, 1.0 + SMALLEST_DIVISOR / 10]])
    found = normaliser(rewards, torch.zeros(2, dtype=torch.int64))
    np.testing.assert_allclose(found.numpy(), [[-0.005, 0.005]], rtol=1e-3)


def test_a_task_without_worlds_has_no_statistics() -> None:
    normaliser = RewardNormaliser(2, std=0.1)
    normaliser(torch.tensor([[1.0, 2.0]]), torch.tensor([1, 1]))
    assert normaliser.count.tolist() == [0, 2]
    assert normaliser.mean.tolist() == [0, 1.5]


def filled(batches: int) -> Replay:
    """Two steps of three worlds, the last one of another task; values tell what they are."""
    replay = Replay(2, np.array([0, 0, 1]))
    for number in range(batches):
        observations = torch.arange(6).view(2, 3, 1) + 10 * number
        replay.add(observations.to(torch.uint8), observations.squeeze(2))
    return replay


@pytest.mark.parametrize(("batches", "kept"), [(1, {0}), (2, {0, 1}), (3, {1, 2})])
def test_novice_samples_come_from_the_last_batches(batches: int, kept: set[int]) -> None:
    shown, actions, tasks = filled(batches).sample_evenly(400, np.random.default_rng(0))
    assert torch.equal(shown.squeeze(1).long(), actions)
    assert set((actions // 10).tolist()) == kept
    assert set((actions % 10).tolist()) == set(range(6))
    assert torch.equal(tasks, (actions % 10 % 3 == 2).long())
    assert tasks.sum() == 200  # evenly, though only one world in three has this task


def test_store_continues_from_its_tree() -> None:
    replay, other = filled(3), Replay(2, np.array([0, 0, 1]))
    other.load(replay.tree(), "cpu")
    more = torch.full((2, 3, 1), 99, dtype=torch.uint8)
    for each in (replay, other):
        each.add(more, more.squeeze(2).long())
    first, second = (r.sample_evenly(50, np.random.default_rng(1)) for r in (replay, other))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_flat_images_are_small_in_a_checkpoint() -> None:
    replay = Replay(4, np.array([0]))
    replay.add(torch.zeros(8, 1, 96, 96, 12, dtype=torch.uint8), torch.zeros(8, 1).long())
    assert replay.tree()["observations"].numel() < 8 * 96 * 96 * 12 / 50


@pytest.mark.parametrize(
    ("metrics", "one_action", "said"),
    [
        ({"discriminator_accuracy": 1.0}, False, "discriminator always right"),
        ({"discriminator_accuracy": 0.46}, False, "discriminator at chance"),
        ({}, True, "one action"),
    ],
)
def test_warnings_come_when_a_sign_has_lasted(
    metrics: dict[str, float | str], one_action: bool, said: str
) -> None:
    watch = Watch()
    for _ in range(PATIENCE - 1):
        assert watch.warnings(metrics, one_action) == ""
    watch = Watch(watch.seen)
    assert watch.warnings(metrics, one_action) == f"{said} for {PATIENCE} updates"
    assert watch.warnings({"discriminator_accuracy": 0.8}, False) == ""
    assert watch.warnings(metrics, one_action) == ""  # counts anew


def test_numbers_that_are_none_are_said_at_once() -> None:
    assert Watch().warnings({"reward": float("nan")}, False) == "not finite"
