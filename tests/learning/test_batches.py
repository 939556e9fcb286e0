"""From samples to what PPO learns from, against slow or hand-made computations."""

import numpy as np
import pytest
import torch

from magical.learning.batches import (
    explained_variance,
    generalised_advantages,
    mean_by_task,
    spread,
)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize("bootstrap", [False, True])
def test_advantages_are_those_of_a_plain_loop(bootstrap: bool) -> None:
    draw, steps, worlds, gamma, lam = rng(), 7, 3, 0.9, 0.7
    rewards, values = draw.normal(size=(2, steps, worlds))
    last, ends = draw.normal(size=worlds), draw.normal(size=(steps, worlds))
    ended = draw.random((steps, worlds)) < 0.3
    following = np.where(ended, ends * bootstrap, np.vstack([values[1:], last]))
    expected = np.zeros((steps, worlds))
    for world in range(worlds):
        for start in range(steps):
            weight = 1.0
            for t in range(start, steps):
                error = rewards[t, world] + gamma * following[t, world] - values[t, world]
                expected[start, world] += weight * error
                weight *= gamma * lam
                if ended[t, world]:
                    break
    found = generalised_advantages(
        torch.from_numpy(rewards),
        torch.from_numpy(values),
        torch.from_numpy(following),
        torch.from_numpy(ended),
        gamma,
        lam,
    )
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)


def test_explained_variance_by_hand() -> None:
    returns = torch.tensor([0.0, 2.0])
    assert explained_variance(torch.tensor([0.5, 1.5]), returns) == pytest.approx(0.75)
    assert explained_variance(returns, returns) == 1.0
    assert explained_variance(returns, torch.ones(2)) == 0.0


def test_minibatches_are_split_evenly_between_tasks() -> None:
    tasks = np.array([0] * 16 + [1] * 16 + [2] * 16)
    order = spread(tasks, rng())
    assert sorted(order) == list(range(48))
    for part in order.reshape(-1, 12):
        assert np.bincount(tasks[part]).tolist() == [4, 4, 4]
    assert not np.array_equal(order, spread(tasks, np.random.default_rng(1)))


def test_score_is_the_mean_over_tasks() -> None:
    scores = [(0, 1.0), (0, 1.0), (0, 1.0), (1, 0.0)]
    assert mean_by_task(scores) == 0.5
