"""Proximal policy optimisation: its loss by hand, then whole runs."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.tests.tiny_runs import checkpoint, tiny
from magical.evaluation import evaluate
from magical.runs import read_metrics
from magical_baselines import load_policy, train
from magical_baselines.algorithms import ppo
from magical_baselines.algorithms.ppo import PPOConfig, Samples, make_policy, ppo_loss


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
    monkeypatch.setattr("magical_baselines.rollouts.EVALUATION_ROLLOUTS", 1)
    config = tiny(PPOConfig, observation="state", evaluate_every=2)
    trained = train(config, tmp_path / "run")
    assert {"evaluation_score", "entropy", "sample_seconds"} < trained.metrics.keys()
    rows = read_metrics(tmp_path / "run")
    assert ["evaluation_score" in row for row in rows] == [False, True, True]  # and at the end
    assert load_policy(tmp_path / "run").observation == "state"


def test_paper_settings_are_table_4s() -> None:
    config = PPOConfig.preset("paper", tasks=("MoveToRegion",))
    assert (config.num_envs, config.num_steps, config.epochs) == (32, 8, 12)
    assert (config.minibatch_size, config.learning_rate, config.clip_range) == (64, 6e-5, 0.01)
    assert (config.gamma, config.gae_lambda, config.ent_coef) == (0.8, 0.8, 1e-5)
    assert (config.max_grad_norm, config.total_steps, config.num_updates) == (1.0, 10**6, 3906)
    assert config.init == "torch"
    assert (config.bootstrap, config.normalise_advantages, config.anneal) == (False, False, True)
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
    (group,) = checkpoint(tmp_path / "run")["optimizer"]["param_groups"]
    assert group["lr"] == pytest.approx(0.3)


def test_a_collapse_is_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logged: list[Any] = []

    def callback(step: int, metrics: Any) -> None:
        logged.append(metrics)

    monkeypatch.setattr("magical_baselines.rollouts.COLLAPSE_UPDATES", 5)
    monkeypatch.setattr(
        "magical_baselines.rollouts.sample_actions",
        lambda logits, uniforms: (torch.full((3,), 5), torch.zeros(3)),
    )
    config = tiny(PPOConfig, observation="state", total_steps=6 * 6)
    train(config, tmp_path / "run", stop_after=4, callback=callback)
    assert "warning" not in logged[-1]
    train(config, tmp_path / "run", resume=True, callback=callback)  # counts are kept
    assert logged[-2]["warning"] == "one action for 5 updates"
    assert read_metrics(tmp_path / "run")[-1]["warning"] == "one action for 6 updates"
