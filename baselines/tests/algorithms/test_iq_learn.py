"""IQ-Learn: its loss against plain arithmetic and a tabular solution, then parts of whole runs."""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import checkpoint, tiny
from magical.demos import Trajectory
from magical.runs import read_metrics
from magical_baselines import train
from magical_baselines.algorithms import iq_learn
from magical_baselines.algorithms.iq_learn import (
    IQLearnConfig,
    IQTrainer,
    iq_loss,
    make_policy,
    soft_value,
)
from magical_baselines.replay import Transitions
from magical_baselines.training import Run


def iq_config(**fields: Any) -> IQLearnConfig:
    return IQLearnConfig.preset("paper", tasks=TASKS, demos="", **fields)


def batch_of(actions: list[int], ends: list[bool]) -> Transitions:
    nothing = torch.zeros(len(actions), 1)
    return Transitions(
        nothing, torch.tensor(actions), nothing, torch.tensor(ends), torch.zeros(len(actions))
    )


def plain_loss(q: Any, following: Any, actions: Any, ends: Any, settings: IQLearnConfig) -> float:
    """The loss, a transition at a time."""
    total, half, alpha = 0.0, len(q) // 2, settings.temperature
    for row in range(len(q)):
        value = alpha * math.log(sum(math.exp(entry / alpha) for entry in q[row]))
        future = 0.0
        if settings.bootstrap or not ends[row]:
            exponentials = (math.exp(entry / alpha) for entry in following[row])
            future = settings.gamma * alpha * math.log(sum(exponentials))
        reward = q[row][actions[row]] - future
        total -= reward / half if row < half else 0.0
        total += (value - future) / len(q)
        total += reward**2 / (4 * settings.chi2_scale) / len(q)
    return total


@pytest.mark.parametrize("bootstrap", [False, True])
def test_loss_against_plain_arithmetic(bootstrap: bool) -> None:
    rng = np.random.default_rng(0)
    q, following = rng.normal(size=(2, 6, 18))
    actions, ends = [0, 3, 17, 17, 2, 5], [False, True, False, True, False, False]
    settings = iq_config(gamma=0.9, temperature=0.2, chi2_scale=0.7, bootstrap=bootstrap)
    next_values = soft_value(torch.from_numpy(following), 0.2)
    loss, parts = iq_loss(torch.from_numpy(q), next_values, batch_of(actions, ends), settings)
    assert loss.item() == pytest.approx(plain_loss(q, following, actions, ends, settings))
    found = {name: part.item() for name, part in parts.items()}
    assert found["loss"] == pytest.approx(loss.item())
    policy = np.exp(q / 0.2) / np.exp(q / 0.2).sum(axis=1, keepdims=True)
    log_probs = np.log(policy[np.arange(6), actions])
    assert found["demo_log_prob"] == pytest.approx(log_probs[:3].mean())
    assert found["entropy"] == pytest.approx(-(policy * np.log(policy))[3:].sum(axis=1).mean())


def test_soft_value_is_the_maximum_of_q_plus_entropy() -> None:
    q = torch.tensor([[1.0, 2.0, 4.0]])
    policy = (q / 0.5).softmax(dim=1)
    expected = (policy * (q - 0.5 * policy.log())).sum()
    assert soft_value(q, 0.5).item() == pytest.approx(expected.item())
    assert soft_value(q, 1e-3).item() == pytest.approx(4.0)


def test_the_minimum_imitates_and_its_rewards_are_the_divergence_s() -> None:
    """One state, which follows itself: occupancies are those of actions, so r is known."""
    settings = iq_config(gamma=0.5, temperature=0.3, chi2_scale=0.5)
    demonstrated, policy = [0, 0, 0, 1], [0, 1, 1, 2]
    batch = batch_of(demonstrated + policy, [False] * 8)
    q = torch.zeros(1, 18, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS([q], max_iter=500, tolerance_grad=1e-12, tolerance_change=0)

    def closure() -> Tensor:
        optimizer.zero_grad()
        rows = q.expand(8, 18)
        loss, _ = iq_loss(rows, soft_value(rows, settings.temperature), batch, settings)
        loss.backward()
        return loss

    optimizer.step(closure)
    probabilities = (q / settings.temperature).softmax(dim=1)[0].tolist()
    rewards = q[0] - settings.gamma * soft_value(q, settings.temperature)
    for action in (0, 1, 2):
        demo = demonstrated.count(action) / 4
        both = (demo + policy.count(action) / 4) / 2
        expected = 2 * settings.chi2_scale * (demo - probabilities[action]) / both
        assert rewards[action].item() == pytest.approx(expected, abs=1e-4)
    assert probabilities[0] > probabilities[1] > probabilities[2]


def test_the_policy_is_the_softmax_of_q() -> None:
    network = make_policy(tiny(IQLearnConfig, temperature=0.2, tasks=TASKS))
    images, tasks = torch.rand(2, 12, 96, 96), torch.tensor([1, 0])
    assert torch.equal(network(images, tasks), network.q(images, tasks) / 0.2)
    assert network.q(images, tasks).abs().max() < 0.1


@pytest.fixture
def trainer(demos: Path, tmp_path: Path) -> Iterator[Any]:
    """Makes a trainer of two tasks that has collected a rollout."""
    with ExitStack() as stack:

        def make(**fields: Any) -> IQTrainer:
            data = {"demos": str(demos), "num_demos": 4}
            config = tiny(IQLearnConfig, tasks=TASKS, augment="none", **data, **fields)
            run = stack.enter_context(Run(tmp_path, config))
            made = stack.enter_context(IQTrainer(config, run))
            made.collect(0)
            return made

        yield make


def test_actions_are_sampled_anew_in_every_step(trainer: Any) -> None:
    subject = trainer(num_envs=2, num_steps=12, total_steps=24, temperature=100.0)
    sampled = subject.replay_buffer.sample([100, 100], np.random.default_rng(0))
    assert len(set(sampled.actions.tolist())) > 6


def test_the_target_network_is_replaced_every_so_many_steps(trainer: Any) -> None:
    subject = trainer(gradient_steps=2, target_every=3, total_steps=60)

    def equal() -> bool:
        pairs = zip(subject.network.parameters(), subject.target.parameters(), strict=True)
        return all(torch.equal(a, b) for a, b in pairs)

    assert equal()
    copies: list[int] = []
    original = subject.target.load_state_dict

    def spy(state: Any) -> None:
        copies.append(len(copies))
        original(state)

    subject.target.load_state_dict = spy
    for update, expected in enumerate([1, 2, 2, 3]):  # before steps 0, 3, 6
        subject.improve(update)
        assert len(copies) == expected
        assert not equal()


def test_gradients_pass_through_the_next_value_without_a_target_network(
    trainer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []

    def spy(q: Tensor, next_values: Tensor, *rest: Any) -> Any:
        seen.append(next_values.requires_grad)
        return iq_loss(q, next_values, *rest)

    monkeypatch.setattr(iq_learn, "iq_loss", spy)
    for target_every in (0, 5):
        trainer(target_every=target_every).improve(0)
    assert seen == [True, False]


def test_batches_are_half_demonstrations_in_equal_parts_of_the_tasks(
    trainer: Any, trajectories: list[Trajectory], monkeypatch: pytest.MonkeyPatch
) -> None:
    subject = trainer(batch_size=8)
    batches: list[Transitions] = []

    def spy(q: Tensor, next_values: Tensor, batch: Transitions, settings: IQLearnConfig) -> Any:
        batches.append(batch)
        before, after = (
            subject.network.q(images, batch.tasks)
            for images in (batch.observations, batch.next_observations)
        )
        assert torch.allclose(q, before)
        assert torch.allclose(next_values, soft_value(after, settings.temperature))
        return iq_loss(q, next_values, batch, settings)

    monkeypatch.setattr(iq_learn, "iq_loss", spy)
    subject.improve(0)
    assert batches[0].tasks.tolist() == [0, 0, 1, 1] * 2
    pictures = {t.frames["ego"][s].tobytes() for t in trajectories for s in range(12) if t.frames}
    newest = (batches[0].observations[:, -3:] * 255).round().byte().permute(0, 2, 3, 1)
    assert [image.contiguous().numpy().tobytes() in pictures for image in newest] == [True] * 4 + [
        False
    ] * 4


def test_it_learns_what_is_demonstrated(demos: Path, tmp_path: Path) -> None:
    config = IQLearnConfig.preset(
        "quick",
        tasks=("MoveToRegion",),
        demos=str(demos),
        num_demos=4,
        network="narrow",
        augment="none",
        num_envs=2,
        num_steps=2,
        total_steps=60,
        gradient_steps=8,
        batch_size=32,
        evaluate_every=0,
        workers=0,
    )
    train(config, tmp_path / "run")
    found = [row["demo_log_prob"] for row in read_metrics(tmp_path / "run")]
    assert found[0] < -2.0  # 18 actions: at random -2.9
    assert found[-1] > -0.5


def test_evaluations_are_logged(demos: Path, tmp_path: Path) -> None:
    config = tiny(IQLearnConfig, demos=str(demos), evaluate_every=1, total_steps=6)
    trained = train(config, tmp_path / "run")
    logged = {"evaluation_score", "loss", "demo_reward", "policy_reward", "value", "sample_seconds"}
    assert logged < trained.metrics.keys()
    assert trained.metrics["environment_steps"] == 6
    assert "replay_buffer" in checkpoint(tmp_path / "run")


def test_paper_settings_are_the_published_codes() -> None:
    config = IQLearnConfig.preset("paper", tasks=("MoveToRegion",), demos="")
    iq = config
    assert (iq.learning_rate, iq.gamma, iq.temperature, iq.chi2_scale) == (1e-4, 0.99, 1e-3, 0.5)
    assert (iq.batch_size, iq.buffer_size, iq.target_every) == (128, 50_000, 0)
    assert iq.bootstrap
    assert iq.gradient_steps == iq.steps_per_update  # one step of the optimiser for each of these
