"""Proximal policy optimisation: its parts against slow or hand-made ones, then whole runs."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.tests.tiny_runs import checkpoint, tiny
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidConfigError, UnknownNameError
from magical.evaluation import evaluate
from magical.runs import read_metrics
from magical_baselines import load_policy, train
from magical_baselines.algorithms import ppo
from magical_baselines.algorithms.ppo import PPOConfig, Samples, make_policy, ppo_loss
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.reinforcement.rollouts import RolloutEnvs, collect_rollout


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def minibatch(actions: list[int], log_probs: list[float], advantages: list[float]) -> Samples:
    count = len(actions)
    return Samples(
        torch.zeros(count, 1),
        torch.tensor(actions),
        torch.tensor(log_probs),
        torch.tensor(advantages),
        torch.tensor([1.0] * count),
        torch.zeros(count, dtype=torch.int64),
    )


def test_loss_by_hand() -> None:
    # Two actions are possible, with probabilities 0.8 and 0.2; they were 0.5 each when chosen:
    # ratios 1.6 and 0.4, clipped to 1.1 and 0.9.
    logits = torch.full((2, 18), -1e9)
    logits[:, 0], logits[:, 1] = math.log(0.8), math.log(0.2)
    half = math.log(0.5)
    values = torch.tensor([0.0, 3.0])  # squared errors 1 and 4
    entropy = -(0.8 * math.log(0.8) + 0.2 * math.log(0.2))
    gains = minibatch([0, 1], [half, half], [2.0, 5.0])
    loss, parts = ppo_loss(logits, values, gains, clip_range=torch.tensor(0.1), ent_coef=0.01)
    policy = -(1.1 * 2.0 + 0.4 * 5.0) / 2  # the minimum: clipped above, not below
    assert loss.item() == pytest.approx(policy + 0.5 * 2.5 - 0.01 * entropy, abs=1e-6)
    expected = [policy, 1.25, entropy, 1.0]
    assert [part.item() for part in parts.values()] == pytest.approx(expected, abs=1e-6)
    losses = minibatch([0, 1], [half, half], [-2.0, -5.0])
    _, parts = ppo_loss(logits, values, losses, clip_range=torch.tensor(0.1), ent_coef=0.0)
    assert parts["policy_loss"].item() == pytest.approx((1.6 * 2.0 + 0.9 * 5.0) / 2, abs=1e-6)


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
    monkeypatch.setattr("magical_baselines.reinforcement.rollouts.NUM_ACTIONS", 1)
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
    assert len(rollout.actions.unique(dim=0)) > 20  # type: ignore[no-untyped-call]


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


def test_learns_from_states(tmp_path: Path) -> None:
    config = PPOConfig.preset(
        "quick",
        tasks=("MoveToRegion",),
        observation="state",
        total_steps=10_240,
        num_envs=16,
        workers=0,
        evaluate_every=0,
    )
    trained = train(config, tmp_path / "run")
    rewards = [row["reward"] for row in read_metrics(trained.folder)]
    assert np.mean(rewards[-10:]) > 2 * np.mean(rewards[:10]) > 0.0
    assert trained.metrics["explained_variance"] > 0.2
    scores = evaluate(trained.policy(), ["magical/MoveToRegion-Demo-v0"], rollouts=4, workers=0)
    assert len(scores) == 4


def test_evaluations_are_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical_baselines.reinforcement.trainer.ROLLOUTS", 1)
    config = tiny(PPOConfig, observation="state", evaluate_every=2)
    trained = train(config, tmp_path / "run")
    assert {"evaluation_score", "entropy", "sample_seconds"} < trained.metrics.keys()
    rows = read_metrics(tmp_path / "run")
    assert ["evaluation_score" in row for row in rows] == [False, True, True]  # and at the end
    assert load_policy(tmp_path / "run").observation == "state"


def test_paper_settings_are_table_4s() -> None:
    config = PPOConfig.preset("paper", tasks=("MoveToRegion",))
    ppo = config.ppo
    assert (ppo.num_envs, ppo.num_steps, ppo.epochs) == (32, 8, 12)
    assert (ppo.minibatch_size, ppo.learning_rate, ppo.clip_range) == (64, 6e-5, 0.01)
    assert (ppo.gamma, ppo.gae_lambda, ppo.ent_coef) == (0.8, 0.8, 1e-5)
    assert (ppo.max_grad_norm, ppo.total_steps, config.num_updates) == (1.0, 10**6, 3906)
    assert ppo.init == "torch"
    assert (ppo.bootstrap, ppo.normalise_advantages, ppo.anneal) == (False, False, True)
    network = make_policy(config)
    assert not any(isinstance(m, torch.nn.BatchNorm2d) for m in network.modules())
    assert [type(m).__name__ for m in network.trunk.modules()].count("Conv2d") == 5


def test_learning_rate_and_clip_range_are_annealed_to_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[float] = []

    def spy(*args: Any) -> Any:
        seen.append(args[3])
        return ppo_loss(*args)

    monkeypatch.setattr(ppo, "ppo_loss", spy)
    config = tiny(
        PPOConfig, observation="state", clip_range=0.3, learning_rate=0.9, minibatch_size=6
    )
    train(config, tmp_path / "run")
    assert seen == pytest.approx([0.3, 0.2, 0.1])
    (group,) = checkpoint(tmp_path / "run")["ppo"]["optimizer"]["param_groups"]
    assert group["lr"] == pytest.approx(0.3)


def test_a_collapse_is_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logged: list[Any] = []

    def callback(step: int, metrics: Any) -> None:
        logged.append(metrics)

    monkeypatch.setattr("magical_baselines.reinforcement.monitoring.COLLAPSE_UPDATES", 5)
    monkeypatch.setattr(
        "magical_baselines.reinforcement.rollouts.sample_actions",
        lambda logits, uniforms: (torch.full((3,), 5), torch.zeros(3)),
    )
    config = tiny(PPOConfig, observation="state", total_steps=6 * 6)
    train(config, tmp_path / "run", stop_after=4, callback=callback)
    assert "warning" not in logged[-1]
    train(config, tmp_path / "run", resume=True, callback=callback)  # counts are kept
    assert logged[-2]["warning"] == "one action for 5 updates"
    assert read_metrics(tmp_path / "run")[-1]["warning"] == "one action for 6 updates"


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"gamma": 1.5}, "gamma"),
        ({"total_steps": 0}, "total_steps"),
        ({"total_steps": 5, "num_envs": 2, "num_steps": 3}, "total_steps: expected at least the 6"),
        ({"num_envs": 1, "tasks": ("MoveToCorner", "MoveToRegion")}, "num_envs"),
        ({"ent_coef": -1.0}, "ent_coef"),
        ({"workers": -1}, "workers"),
        (
            {"observation": "state", "tasks": ("MoveToCorner", "MoveToRegion")},
            "state vectors differ between tasks",
        ),
    ],
)
def test_impossible_settings(fields: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidConfigError, match=named):
        tiny(PPOConfig, **fields)


def test_unknown_words() -> None:
    with pytest.raises(UnknownNameError, match="reward 'none'"):
        tiny(PPOConfig, reward="none")
    with pytest.raises(UnknownNameError, match="observation 'states'"):
        tiny(PPOConfig, observation="states")


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
    with pytest.raises(UnknownNameError, match="init"):
        tiny(PPOConfig, init="zero")
