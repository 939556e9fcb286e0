"""Acting in environments: rollouts, rewards, PPO, GAIL, WGAIL-GP, AL, IQ-Learn."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor, nn

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import tiny
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import evaluate
from magical.observe import PRESETS
from magical.runs import read_metrics
from magical_baselines import load_policy, train
from magical_baselines.algorithms.al import ALConfig, feature_weights, make_autoencoder
from magical_baselines.algorithms.gail import (
    DiscriminatorBatch,
    GAILConfig,
    gail_loss,
    make_discriminator,
    make_policy,
)
from magical_baselines.algorithms.iq_learn import IQLearnConfig, iq_loss, soft_value
from magical_baselines.algorithms.ppo import PPOConfig, PPOTrainer, Samples, compute_gae, ppo_loss
from magical_baselines.algorithms.wgail_gp import critic_loss, gradient_penalty, interpolate
from magical_baselines.data import ExpertData, Transitions
from magical_baselines.rollouts import (
    COLLAPSE_UPDATES,
    Monitor,
    RewardNormaliser,
    Rollout,
    RolloutEnvs,
    collect_rollout,
    shuffle_evenly,
)

Floats = NDArray[np.float64]


def rng():
    return np.random.default_rng(0)


@pytest.mark.parametrize("bootstrap", [False, True])
def test_advantages_are_those_of_a_plain_loop(bootstrap):
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


def rollout_of(values, following, dones):
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


def test_minibatches_are_split_evenly_between_tasks():
    tasks = np.array([0] * 16 + [1] * 16 + [2] * 16)
    order = shuffle_evenly(tasks, rng())
    assert sorted(order) == list(range(48))
    for part in order.reshape(-1, 12):
        assert np.bincount(tasks[part]).tolist() == [4, 4, 4]
    assert not np.array_equal(order, shuffle_evenly(tasks, np.random.default_rng(1)))


def scripted(observations, tasks):
    """Acts without a network: always the same action; values tell observations apart."""
    logits = torch.full((len(observations), 18), -1e9)
    logits[:, 1] = 0.0
    return logits, value_of(observations)


def value_of(observations):
    return observations.flatten(1).sum(dim=1)


@pytest.mark.parametrize("bootstrap", [False, True])
def test_rollouts_against_the_environment(bootstrap, monkeypatch):
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


def test_rewards_are_normalised_as_two_passes_would():
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


@pytest.mark.parametrize(
    ("accuracy", "one_action", "warning"),
    [
        (1.0, False, "discriminator always right"),
        (0.46, False, "discriminator at chance"),
        (None, True, "one action"),
    ],
)
def test_a_symptom_that_lasts_is_warned_of(accuracy, one_action, warning):
    monitor, again = Monitor(), Monitor()
    for each in (monitor, again):
        each.add_rollout(torch.tensor([[1, 1 if one_action else 0]]), ())
    for _ in range(COLLAPSE_UPDATES - 1):
        assert monitor.metrics(accuracy) == {}
    again._counts = monitor.state_dict()["collapse"]
    assert again.metrics(accuracy) == {"warning": f"{warning} for {COLLAPSE_UPDATES} updates"}
    again.add_rollout(torch.tensor([[0, 1]]), ())
    assert again.metrics(0.8) == {}
    again.add_rollout(torch.tensor([[1, 1 if one_action else 0]]), ())
    assert again.metrics(accuracy) == {}  # the count restarts


def minibatch(actions, log_probs, advantages):
    count = len(actions)
    return Samples(
        torch.zeros(count, 1),
        torch.tensor(actions),
        torch.tensor(log_probs),
        torch.tensor(advantages),
        torch.tensor([1.0] * count),
        torch.zeros(count, dtype=torch.int64),
    )


def test_loss_by_hand():
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


def test_learns_from_states(tmp_path):
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


def test_evaluations_are_logged(tmp_path, monkeypatch):
    monkeypatch.setattr("magical_baselines.rollouts.EVALUATION_ROLLOUTS", 1)
    config = tiny(PPOConfig, observation="state", evaluate_every=2)
    trained = train(config, tmp_path / "run")
    assert {"evaluation_score", "entropy", "sample_seconds"} < trained.metrics.keys()
    rows = read_metrics(tmp_path / "run")
    assert ["evaluation_score" in row for row in rows] == [False, True, True]  # and at the end
    assert load_policy(tmp_path / "run").observation == "state"


class Linear(nn.Module):
    """A discriminator whose logit is weight . image, times a factor for each action."""

    def __init__(self, size=6):
        super().__init__()
        self.weight = nn.Parameter(torch.linspace(-1.0, 2.0, size))

    def forward(self, images, actions, tasks):
        logits: Tensor = images.flatten(1) @ self.weight * (1.0 + actions)
        return logits


def batch_of(images, actions):
    return DiscriminatorBatch(
        images, torch.tensor(actions), torch.zeros(len(actions), dtype=torch.int64)
    )


def given(logits):
    """A network that answers with these logits."""
    return lambda images, actions, tasks: torch.tensor(logits)


def test_discriminator_loss_by_hand():
    batch = batch_of(torch.zeros(4, 3, 1, 1), [0] * 4)
    answers = given([math.log(3.0), -1e-3, math.log(3.0), -20.0])  # expert, expert, novice, novice
    loss, report = gail_loss(answers, batch, np.random.default_rng(0))
    second = math.log(1 + math.exp(1e-3))  # -log sigmoid(-0.001)
    assert loss.item() == pytest.approx((math.log(4 / 3) + second + math.log(4)) / 4, abs=1e-6)
    assert report["discriminator_accuracy"].item() == 0.5


def test_gradient_penalty_against_finite_differences():
    torch.manual_seed(0)
    first, second = nn.Linear(12, 5).double(), nn.Linear(5, 1).double()

    def critic(images, actions, tasks):
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
    penalty.backward()
    assert first.weight.grad is not None
    assert first.weight.grad.abs().sum() > 0


def test_images_between_have_the_nearer_ones_action():
    half = 200
    images = torch.cat([torch.ones(half, 3, 1, 1), torch.zeros(half, 3, 1, 1)])
    batch = batch_of(images, [7] * half + [3] * half)
    between, actions, tasks = interpolate(batch, np.random.default_rng(0))
    shares = between[:, 0, 0, 0]  # expert's images are ones
    assert torch.equal(actions == 7, shares > 0.5)
    assert shares.min() < 0.05 < 0.95 < shares.max()
    assert between.flatten(1).std(dim=1).max() == 0
    assert len(tasks) == half


def test_critic_loss_by_hand():
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


CONVENTIONS = ("appendix", "published")


def small(demos, preset="quick", **fields):
    return tiny(ALConfig, preset, **{"tasks": TASKS[:1], "demos": str(demos), **fields})


def test_weights_are_those_of_a_numerical_maximiser():
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


@pytest.fixture(scope="module")
def expert(trajectories):
    return ExpertData([(TASKS[0], trajectories[0])], TASKS[:1], PRESETS["LoRes4E"])


def test_rewards_are_normalised_and_higher_for_what_the_expert_did(
    demos, expert, tmp_path, monkeypatch
):
    seen: list[torch.Tensor] = []
    collect, improve = PPOTrainer.collect_rollout, PPOTrainer.improve_policy

    def with_the_experts(ppo, update):
        rollout, rows = collect(ppo, update), np.arange(2)
        rollout.observations[:, 0] = expert.images(rows)
        rollout.actions[:, 0] = expert.labels(rows)[0]
        return rollout

    def noted(ppo, update, rollout, raw, *others):
        seen.append(raw)
        return improve(ppo, update, rollout, raw, *others)

    monkeypatch.setattr(PPOTrainer, "collect_rollout", with_the_experts)
    monkeypatch.setattr(PPOTrainer, "improve_policy", noted)
    config = small(demos, pretraining_batches=1, total_steps=6, reward_std=0.3)
    metrics = train(config, tmp_path / "run").metrics
    (raw,) = seen
    assert raw[:, 0].mean() > raw.mean() + raw.std() / 2
    assert metrics["reward"] == pytest.approx(0.0, abs=1e-5)
    assert metrics["reward_std"] == pytest.approx(0.3, rel=1e-3)


@pytest.mark.parametrize("conventions", CONVENTIONS)
def test_features_are_of_evaluation_mode(demos, tmp_path, conventions, monkeypatch):
    """By the published code's conventions a small batch passes in training mode besides."""
    passes: list[tuple[bool, int]] = []  # of the encoder: in training mode, samples

    def watched(config):
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


def iq_config(**fields):
    return IQLearnConfig.preset("paper", tasks=TASKS, demos="", **fields)


def transitions_of(actions, ends):
    nothing = torch.zeros(len(actions), 1)
    return Transitions(
        nothing, torch.tensor(actions), nothing, torch.tensor(ends), torch.zeros(len(actions))
    )


def plain_loss(q, following, actions, ends, settings):
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
def test_loss_against_plain_arithmetic(bootstrap):
    rng = np.random.default_rng(0)
    q, following = rng.normal(size=(2, 6, 18))
    actions, ends = [0, 3, 17, 17, 2, 5], [False, True, False, True, False, False]
    settings = iq_config(gamma=0.9, temperature=0.2, chi2_scale=0.7, bootstrap=bootstrap)
    next_values = soft_value(torch.from_numpy(following), 0.2)
    loss, parts = iq_loss(torch.from_numpy(q), next_values, transitions_of(actions, ends), settings)
    assert loss.item() == pytest.approx(plain_loss(q, following, actions, ends, settings))
    found = {name: part.item() for name, part in parts.items()}
    assert found["loss"] == pytest.approx(loss.item())
    policy = np.exp(q / 0.2) / np.exp(q / 0.2).sum(axis=1, keepdims=True)
    log_probs = np.log(policy[np.arange(6), actions])
    assert found["demo_log_prob"] == pytest.approx(log_probs[:3].mean())
    assert found["entropy"] == pytest.approx(-(policy * np.log(policy))[3:].sum(axis=1).mean())


def test_the_minimum_imitates_and_its_rewards_are_the_divergence_s():
    """One state, which follows itself: occupancies are those of actions, so r is known."""
    settings = iq_config(gamma=0.5, temperature=0.3, chi2_scale=0.5)
    demonstrated, policy = [0, 0, 0, 1], [0, 1, 1, 2]
    batch = transitions_of(demonstrated + policy, [False] * 8)
    q = torch.zeros(1, 18, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS([q], max_iter=500, tolerance_grad=1e-12, tolerance_change=0)

    def closure():
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


def test_it_learns_what_is_demonstrated(demos, tmp_path):
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


def test_the_discriminator_may_have_a_network_of_its_own():
    for own, layers in (("", 1), ("paper", 2)):
        fields = {"network": "narrow", "discriminator_network": own, "demos": "unused"}
        config = tiny(GAILConfig, "published-code", **fields)
        linear = make_discriminator(config).trunk.linear
        assert len(linear) == 2 * layers  # each with its ReLU
        assert len(make_policy(config).trunk.linear) == 2
