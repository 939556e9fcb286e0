"""Advantages, value targets and minibatches of PPO, against slow or hand-made computations."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from magical_baselines.algorithms.ppo import compute_gae, make_samples
from magical_baselines.reinforcement.monitoring import explained_variance
from magical_baselines.reinforcement.rollouts import Rollout, shuffle_evenly

Floats = NDArray[np.float64]


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize("bootstrap", [False, True])
def test_advantages_are_those_of_a_plain_loop(bootstrap: bool) -> None:
    random, steps, envs, gamma, lam = rng(), 7, 3, 0.9, 0.7
    rewards, values = random.normal(size=(2, steps, envs))
    last, ends = random.normal(size=envs), random.normal(size=(steps, envs))
    dones = random.random((steps, envs)) < 0.3
    following = np.where(dones, ends * bootstrap, np.vstack([values[1:], last]))
    expected = np.zeros((steps, envs))
    for env in range(envs):
        for start in range(steps):
            weight = 1.0
            for t in range(start, steps):
                error = rewards[t, env] + gamma * following[t, env] - values[t, env]
                expected[start, env] += weight * error
                weight *= gamma * lam
                if dones[t, env]:
                    break
    rollout = rollout_of(values, following, dones)
    found = compute_gae(rollout, torch.from_numpy(rewards), gamma, lam)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)


def rollout_of(values: Floats, following: Floats, dones: NDArray[np.bool_]) -> Rollout:
    """Of three environments, the last of another task; observations tell steps apart."""
    unused = torch.zeros(values.shape)
    return Rollout(
        observations=torch.arange(values.size).view(*values.shape, 1) / values.size,
        actions=unused,
        log_probs=unused,
        values=torch.from_numpy(values),
        next_values=torch.from_numpy(following),
        rewards=unused,
        dones=torch.from_numpy(dones),
        tasks=torch.tensor([0, 0, 1]),
        scores=(),
    )


@pytest.mark.parametrize("normalise", [False, True])
def test_samples_are_the_steps_of_a_rollout_one_after_another(normalise: bool) -> None:
    values, following, rewards = rng().normal(size=(3, 4, 3))
    rollout = rollout_of(values, following, np.zeros((4, 3), np.bool_))
    plain = compute_gae(rollout, torch.from_numpy(rewards), 0.9, 0.7)
    samples = make_samples(rollout, torch.from_numpy(rewards), 0.9, 0.7, normalise)
    assert samples.tasks.view(4, 3).tolist() == [[0, 0, 1]] * 4
    assert torch.equal(samples.observations.flatten(), torch.arange(12) / 12)
    torch.testing.assert_close(samples.returns.view(4, 3), plain + rollout.values)
    scaled = (plain - plain.mean()) / plain.std() if normalise else plain
    torch.testing.assert_close(samples.advantages.view(4, 3), scaled)


def test_explained_variance_by_hand() -> None:
    returns = torch.tensor([0.0, 2.0])
    assert explained_variance(torch.tensor([0.5, 1.5]), returns) == pytest.approx(0.75)
    assert explained_variance(returns, returns) == 1.0
    assert explained_variance(returns, torch.ones(2)) == 0.0


def test_minibatches_are_split_evenly_between_tasks() -> None:
    tasks = np.array([0] * 16 + [1] * 16 + [2] * 16)
    order = shuffle_evenly(tasks, rng())
    assert sorted(order) == list(range(48))
    for part in order.reshape(-1, 12):
        assert np.bincount(tasks[part]).tolist() == [4, 4, 4]
    assert not np.array_equal(order, shuffle_evenly(tasks, np.random.default_rng(1)))
