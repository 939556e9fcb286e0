"""Acting in environments: rollouts, advantages, reward normalisation, warnings of a collapse."""

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from baselines.tests.tiny_runs import tiny
from magical.envs.vector import MagicalVectorEnv
from magical_baselines.algorithms.ppo import PPOConfig, compute_gae, make_policy, make_samples
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.rollouts import (
    COLLAPSE_UPDATES,
    FLOOR,
    Monitor,
    RewardNormaliser,
    Rollout,
    RolloutEnvs,
    collect_rollout,
    explained_variance,
    mean_by_task,
    shuffle_evenly,
)

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


def scripted(observations: torch.Tensor, tasks: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Acts without a network: always the same action; values tell observations apart."""
    logits = torch.full((len(observations), 18), -1e9)
    logits[:, 1] = 0.0
    return logits, value_of(observations)


def value_of(observations: torch.Tensor) -> torch.Tensor:
    return observations.flatten(1).sum(dim=1)


@pytest.mark.parametrize("bootstrap", [False, True])
def test_rollouts_against_the_environment(bootstrap: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    horizon = 40
    config = tiny(PPOConfig, observation="state")
    monkeypatch.setattr("magical_baselines.rollouts.NUM_ACTIONS", 1)
    with RolloutEnvs(config, "cpu", "dense") as envs:
        monkeypatch.setattr(envs, "_horizons", np.ones(3, np.int64))  # all start at once
        envs.reset()
        rollout = collect_rollout(envs, scripted, horizon + 2, bootstrap, rng())
        states = [envs.envs.get_state(row) for row in range(3)]
        present = value_of(envs.observations())
    assert rollout.actions.eq(1).all()
    assert rollout.log_probs.eq(0).all()
    assert rollout.dones.any(dim=1).nonzero().tolist() == [[horizon - 1]]
    assert len(rollout.scores) == 3
    assert [len(state["actions"]) for state in states] == [2, 2, 2]
    env = MagicalVectorEnv(
        ["magical/MoveToRegion-Demo-v0"], workers=0, observation="state", reward="dense"
    )
    shown, _ = env.reset(seed=0)
    for t in range(horizon):  # Demo has one scene: all episodes are alike
        np.testing.assert_array_equal(rollout.observations[t].numpy(), np.repeat(shown, 3, 0))
        shown, rewards, *_ = env.step(np.array([1]))
        np.testing.assert_allclose(rollout.rewards[t].numpy(), rewards.repeat(3), rtol=1e-6)
    env.close()
    torch.testing.assert_close(rollout.values, torch.stack([*map(value_of, rollout.observations)]))
    expected = torch.cat([rollout.values[1:], present[None]])
    expected[horizon - 1] = value_of(torch.from_numpy(shown)) if bootstrap else 0.0
    torch.testing.assert_close(rollout.next_values, expected)
    assert len(set(rollout.values[:, 0].tolist())) > horizon / 2


def test_scores_and_final_values_are_of_the_tasks_whose_episodes_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def random(
        observations: torch.Tensor, tasks: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.zeros(len(tasks), 18), tasks + 1.0

    config = tiny(PPOConfig, tasks=("MoveToCorner", "MoveToRegion"), num_envs=2)
    with RolloutEnvs(config, "cpu") as envs:
        monkeypatch.setattr(envs, "_horizons", np.ones(2, np.int64))  # both start at once
        envs.reset()
        rollout = collect_rollout(envs, random, 40, True, rng())
    assert [task for task, _ in rollout.scores] == [1]
    assert rollout.next_values.tolist() == [[1.0, 2.0]] * 40
    assert len(rollout.actions.unique(dim=0)) > 20


def test_observations_may_be_views_with_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def scripted(observations: torch.Tensor, tasks: torch.Tensor) -> Any:
        seen.append(observations)
        return torch.zeros(len(tasks), 18), torch.zeros(len(tasks))

    with RolloutEnvs(tiny(PPOConfig, num_envs=2, workers=0), "cpu") as envs:
        whole = envs._network_input
        monkeypatch.setattr(envs, "_network_input", lambda images: whole(images)[:, 9:])
        envs.reset()
        rollout = collect_rollout(envs, scripted, 3, False, rng())
    assert torch.equal(to_unit(rollout.observations), torch.stack(seen[:3]))


def test_environments_start_at_different_times() -> None:
    config = tiny(PPOConfig, observation="state", num_envs=8)
    with RolloutEnvs(config, "cpu") as envs:
        envs.reset()
        steps = [len(envs.envs.get_state(row)["actions"]) for row in range(8)]
    assert max(steps) < 40
    assert len(set(steps)) > 4


def test_the_centred_init_tells_frames_apart() -> None:
    with RolloutEnvs(tiny(PPOConfig, num_envs=8), "cpu") as envs:
        envs.reset()
        frames = collect_rollout(envs, scripted, 2, False, rng()).observations[0]
    spreads = {}
    for init in ("torch", "centred"):
        network = make_policy(tiny(PPOConfig, init=init))
        with torch.no_grad():
            images = to_unit(frames)
            spreads[init] = network.trunk(images).std(dim=0).mean().item()
            logits, _ = network.logits_and_values(images, torch.zeros(8, dtype=torch.int64))
        assert logits.abs().max() < 0.3
    assert spreads["centred"] > 10 * spreads["torch"]


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
