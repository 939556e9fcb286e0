"""Apprenticeship learning: weights against a numerical maximiser, features, whole runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import assert_same, checkpoint, tiny
from magical.demos import Trajectory
from magical.observe import PRESETS
from magical_baselines import train
from magical_baselines.algorithms import al
from magical_baselines.algorithms.al import (
    ALConfig,
    Autoencoder,
    autoencoder_loss,
    feature_weights,
    make_autoencoder,
    sample_batch,
)
from magical_baselines.algorithms.ppo import PPOTrainer
from magical_baselines.data import ExpertData
from magical_baselines.replay import RecentRollouts
from magical_baselines.rollouts import Metrics, Rollout

CONVENTIONS = ("appendix", "published")


def small(demos: Path | str, preset: str = "quick", **fields: Any) -> ALConfig:
    return tiny(ALConfig, preset, **{"tasks": TASKS[:1], "demos": str(demos), **fields})


def test_weights_are_those_of_a_numerical_maximiser() -> None:
    torch.manual_seed(0)
    mixing = torch.randn(5, 5).double()
    expert, novice = (torch.randn(60, 5).double() @ mixing + shift for shift in (0.5, 0.0))
    difference = (expert.mean(0) - novice.mean(0)).numpy()
    best = minimize(
        lambda w: -w @ difference,
        np.full(5, 0.1),
        constraints={"type": "ineq", "fun": lambda w: 4.0 - w @ w},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    weights, gap = feature_weights(expert, novice)
    np.testing.assert_allclose(weights.numpy(), best.x, rtol=1e-5, atol=4e-6)
    assert gap.item() == pytest.approx(-best.fun, rel=4e-6)


def test_no_difference_no_weights() -> None:
    for features in (torch.randn(8, 32), torch.zeros(8, 32)):
        weights, gap = feature_weights(features, features)
        assert weights.abs().sum().item() == gap.item() == 0.0


def test_autoencoder_loss_by_hand() -> None:
    images = torch.zeros(1, 3, 1, 1)
    made = torch.tensor([1.0, 2.0, 3.0]).view(1, 3, 1, 1)
    error, cross = autoencoder_loss(images, torch.tensor([4]), made, torch.zeros(1, 18))
    assert error.item() == pytest.approx((1 + 4 + 9) / 3)
    assert cross.item() == pytest.approx(np.log(18))


def test_layers_are_those_of_the_specification() -> None:
    network = make_autoencoder(ALConfig.preset("paper", tasks=("MoveToCorner",), demos=""))
    assert network.encoder.num_features == 32
    linear = [m for m in network.encoder.linear if isinstance(m, torch.nn.Linear)]
    assert [(m.in_features, m.out_features) for m in linear] == [(4608 + 18, 256), (256, 32)]
    convolutions = [m for m in network.image if isinstance(m, torch.nn.Conv2d)]
    outputs = [m.out_channels for m in convolutions]
    assert outputs == [64, 64, 64, 32, 32, 32, 32, 12]


def test_autoencoder_learns_what_it_is_shown(trajectories: list[Trajectory]) -> None:
    torch.manual_seed(0)
    data = ExpertData([(TASKS[0], trajectories[0])], TASKS[:1], PRESETS["LoRes4E"])
    rows = np.arange(4)
    images, (actions, _) = data.images(rows) / 255.0, data.labels(rows)
    network = Autoencoder(small("", network="light"))
    optimizer = torch.optim.Adam(network.parameters(), 1e-3)
    losses = []
    for _ in range(15):
        error, cross = autoencoder_loss(images, actions, *network(images, actions))
        optimizer.zero_grad()
        (error + cross).backward()
        optimizer.step()
        losses.append((error.item(), cross.item()))
    assert losses[-1][0] < 0.7 * losses[0][0]
    assert losses[-1][1] < losses[0][1]


def test_resumed_runs_are_bit_equal(demos: Path, tmp_path: Path) -> None:
    config = small(demos)
    whole = tmp_path / "whole"
    assert train(config, whole).step == 5
    for stops in (1, 2, 3):  # in pretraining, at its end, in an update
        parts = tmp_path / f"stopped after {stops}"
        assert train(config, parts, stop_after=stops).step == stops
        assert train(config, parts, resume=True).finished
        assert_same(checkpoint(whole), checkpoint(parts))


def test_paper_s_pretraining() -> None:
    config = ALConfig.preset("paper", tasks=("MoveToCorner",), demos="")
    assert config.pretraining_learning_rate == 3e-4
    assert config.num_updates == 8192 + 3906


@pytest.fixture(scope="module")
def expert(trajectories: list[Trajectory]) -> ExpertData:
    return ExpertData([(TASKS[0], trajectories[0])], TASKS[:1], PRESETS["LoRes4E"])


def test_published_code_settings() -> None:
    config = ALConfig.preset("published-code", tasks=("MoveToCorner",), demos="")
    assert (config.pretraining_batch_size, config.feature_samples) == (12, 264)
    assert (config.action_input, config.pixel_range) == ("embedding", (-1.0, 1.0))
    network = make_autoencoder(config)
    assert network.encoder.embedding is not None
    kinds = [type(module) for module in network.image]
    assert kinds.count(torch.nn.BatchNorm2d) == 7
    assert all(
        kinds[i - 1 : i + 2] == [torch.nn.Conv2d, torch.nn.BatchNorm2d, torch.nn.ReLU]
        for i, kind in enumerate(kinds)
        if kind is torch.nn.BatchNorm2d
    )
    assert {m.padding_mode for m in network.image if isinstance(m, torch.nn.Conv2d)} == {"reflect"}


@pytest.mark.parametrize("conventions", CONVENTIONS)
def test_pretraining_images_are_plain_by_the_published_codes_conventions(
    conventions: str, demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[torch.Tensor] = []

    def watched(images: torch.Tensor, *others: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        seen.append(images)
        return autoencoder_loss(images, *others)

    monkeypatch.setattr(al, "autoencoder_loss", watched)
    config = small(demos, conventions=conventions, augment="noise")
    train(config, tmp_path / "run", stop_after=1)
    plain = (seen[0] * 255).round() / 255
    assert torch.allclose(seen[0], plain, atol=1e-6) == (conventions == "published")


def test_a_decoder_without_weights_gives_the_zero_of_the_encoders_range(
    expert: ExpertData,
) -> None:
    rows = np.arange(8)
    images, actions = expert.images(rows) / 255.0, expert.labels(rows)[0]
    for conventions, (middle, white) in zip(CONVENTIONS, ((0.0, 1.0), (0.5, 1.0)), strict=True):
        autoencoder = make_autoencoder(small("", conventions=conventions))
        last: Any = autoencoder.image[-1]
        for bias, expected in ((0.0, middle), (1.0, white)):
            torch.nn.init.zeros_(last.weight)
            torch.nn.init.constant_(last.bias, bias)
            decoded = autoencoder(images, actions)[0]
            torch.testing.assert_close(decoded, torch.full_like(images, expected))


def test_images_for_w_are_augmented_if_configured(expert: ExpertData) -> None:
    replay_buffer = RecentRollouts(np.zeros(2, np.int64), "cpu")
    replay_buffer.add(expert.images(np.arange(4)).view(2, 2, 12, 96, 96), torch.zeros(2, 2).long())
    plain, augmented = (
        sample_batch(
            small("", feature_samples=3, augment="noise", conventions=conventions),
            expert,
            replay_buffer,
            np.random.default_rng(0),
        )[0]
        for conventions in CONVENTIONS
    )
    assert plain.shape == augmented.shape == (6, 12, 96, 96)
    torch.testing.assert_close(plain * 255, (plain * 255).round())
    assert 0.0 < (augmented - plain).abs().mean() < 0.02


def test_batch_norm_moves_on_in_training_mode_alone(demos: Path, tmp_path: Path) -> None:
    for conventions, moves in zip(CONVENTIONS, (False, True), strict=True):
        config = small(demos, conventions=conventions)
        folder = tmp_path / conventions
        train(config, folder, stop_after=config.pretraining_batches)
        pretrained = checkpoint(folder)["autoencoder"]
        train(config, folder, resume=True)
        trained = checkpoint(folder)["autoencoder"]
        changed = {name for name in trained if not torch.equal(trained[name], pretrained[name])}
        assert bool(changed) == moves
        assert all("running" in name or "num_batches" in name for name in changed)


def test_rewards_are_normalised_and_higher_for_what_the_expert_did(
    demos: Path, expert: ExpertData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[torch.Tensor] = []
    collect, improve = PPOTrainer.collect_rollout, PPOTrainer.improve_policy

    def with_the_experts(ppo: PPOTrainer, update: int) -> Rollout:
        rollout, rows = collect(ppo, update), np.arange(2)
        rollout.observations[:, 0] = expert.images(rows)
        rollout.actions[:, 0] = expert.labels(rows)[0]
        return rollout

    def noted(ppo: PPOTrainer, update: int, rollout: Rollout, rewards: torch.Tensor) -> Metrics:
        seen.append(rewards)
        return improve(ppo, update, rollout, rewards)

    monkeypatch.setattr(PPOTrainer, "collect_rollout", with_the_experts)
    monkeypatch.setattr(PPOTrainer, "improve_policy", noted)
    config = small(demos, pretraining_batches=1, total_steps=6, reward_std=0.3)
    train(config, tmp_path / "run")
    (rewards,) = seen
    assert rewards[:, 0].mean() > 0.2 > rewards[:, 1:].mean()
    assert rewards.mean().item() == pytest.approx(0.0, abs=1e-5)
    assert rewards.std(correction=0).item() == pytest.approx(0.3, rel=1e-3)


@pytest.mark.parametrize("conventions", CONVENTIONS)
def test_features_are_of_evaluation_mode(
    demos: Path, tmp_path: Path, conventions: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the published code's conventions a small batch passes in training mode besides."""
    passes: list[tuple[bool, int]] = []  # of the encoder: in training mode, samples

    def watched(config: ALConfig) -> Autoencoder:
        autoencoder = make_autoencoder(config)
        note = lambda encoder, inputs: passes.append((encoder.training, len(inputs[0])))  # noqa: E731
        autoencoder.encoder.register_forward_pre_hook(note)
        return autoencoder

    monkeypatch.setattr("magical_baselines.algorithms.al.make_autoencoder", watched)
    config = small(demos, conventions=conventions, feature_samples=20)
    train(config, tmp_path / "run", stop_after=config.pretraining_batches)
    passes.clear()
    train(config, tmp_path / "run", resume=True, stop_after=1)
    assert (False, 40) in passes
    training = [samples for is_training, samples in passes if is_training]
    assert training == ([24] if conventions == "published" else [])
