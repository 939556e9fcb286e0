"""What the published code does differently: each setting changes something, presets, whole runs."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import tiny
from magical.cli import main
from magical.evaluation import Policy
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import roll_out
from magical.scene import NUM_ACTIONS
from magical_baselines import train
from magical_baselines.algorithms import bc, ppo
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.gail import DiscriminatorBatch, GAILConfig, make_discriminator
from magical_baselines.algorithms.ppo import PPOConfig
from magical_baselines.algorithms.wgail_gp import WGAILGPConfig, critic_loss, gradient_penalty
from magical_baselines.models import EMBEDDING, Trunk
from magical_baselines.rollouts import RewardNormaliser, RolloutEnvs

ONE = TASKS[:1]
IMAGE = (12, 96, 96)


def test_training_episodes_have_the_configured_horizon() -> None:
    tasks = ("MoveToRegion", "ClusterColour")
    config = tiny(PPOConfig, tasks=tasks, reward="score", horizon="published")
    with RolloutEnvs(config, "cpu") as envs:
        envs.reset()
        assert [state.horizon for state in envs.envs.states()] == [40, 40, 240]


def test_the_monitoring_evaluation_has_the_configured_horizon(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked = []

    def recorded(policy: Policy, evaluation: Evaluation, workers: int | None) -> Any:
        asked.append(evaluation.horizon)
        return roll_out(policy, replace(evaluation, horizon=1, rollouts=1), workers=workers)

    monkeypatch.setattr("magical_baselines.rollouts.roll_out", recorded)
    for horizon in ("appendix", "published"):
        config = tiny(
            PPOConfig, tasks=("ClusterColour",), reward="score", horizon=horizon, evaluate_every=3
        )
        train(config, tmp_path / horizon)
    assert asked == [None, "published"]


@pytest.mark.parametrize(
    ("algorithm", "more", "message"),
    [
        ("ppo", ["--preset", "published-code"], "invalid choice 'published-code'"),
        ("dagger", ["--preset", "published-code"], "invalid choice 'published-code'"),
        ("gail", ["--horizon", "published"], "one horizon only: MoveToRegion (40 steps)"),
        ("bc", ["--horizon", "published"], "Unrecognized options: --horizon, published"),
    ],
)
def test_what_an_algorithm_or_task_lacks_is_wrong_usage(
    algorithm: str, more: list[str], message: str, tmp_path: Path, capsys: Any
) -> None:
    command = ["train", algorithm, "--task", "MoveToRegion", "--out", str(tmp_path / "run"), *more]
    demos = [] if algorithm == "ppo" else ["--demos", str(tmp_path)]
    assert main([*command, *demos]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def first_input(trunk: Trunk, images: Tensor, *actions: Tensor) -> Tensor:
    """What the first convolution of a trunk gets."""
    seen: list[Tensor] = []
    assert isinstance(trunk.convolutions, nn.Sequential)
    trunk.convolutions[0].register_forward_hook(lambda _, inputs, __: seen.append(inputs[0]))
    trunk(images, *actions)
    return seen[0]


def test_pixels_are_mapped_to_the_configured_range() -> None:
    images = torch.rand(2, *IMAGE, generator=torch.Generator().manual_seed(0))
    assert torch.equal(first_input(Trunk("light", IMAGE), images), images)
    symmetric = Trunk("light", IMAGE, pixel_range=(-1.0, 1.0))
    assert torch.allclose(first_input(symmetric, images), 2.0 * images - 1.0)
    once = symmetric.to_range(images)
    assert torch.equal(symmetric(once, in_range=True), symmetric(images))
    vectors = torch.rand(2, 27)
    networks = [Trunk("light", (27,), pixel_range=pixels) for pixels in ((0.0, 1.0), (-1.0, 1.0))]
    networks[1].load_state_dict(networks[0].state_dict())
    assert torch.equal(networks[0](vectors), networks[1](vectors))
    assert networks[1].to_range(vectors) is vectors


@pytest.mark.parametrize(
    ("network", "sizes"), [("paper", (4608, 256 + 32)), ("light", (2304 + 32,))]
)
def test_the_action_s_embedding_is_joined_before_the_last_layer(
    network: str, sizes: tuple[int, ...]
) -> None:
    trunk = Trunk(network, IMAGE, action_input="embedding")
    layers = [layer for layer in trunk.linear if isinstance(layer, nn.Linear)]
    assert tuple(layer.in_features for layer in layers) == sizes
    assert trunk.embedding is not None
    assert trunk.embedding.weight.shape == (NUM_ACTIONS, EMBEDDING)
    images, actions = torch.rand(2, *IMAGE), torch.tensor([3, 5])
    seen: list[Tensor] = []
    layers[-1].register_forward_hook(lambda _, inputs, __: seen.append(inputs[0]))
    assert trunk(images, actions).shape == (2, trunk.num_features)
    assert torch.equal(seen[0][:, -EMBEDDING:], trunk.embedding(actions))


def last_layers(make: Callable[[str], nn.Module]) -> dict[str, Tensor]:
    """The weights that the published code's conventions initialise otherwise, under these."""
    published, default = (make(name).state_dict() for name in ("published", "appendix"))
    shared = [name for name in default if published[name].shape == default[name].shape]
    return {n: published[n] for n in shared if not torch.equal(default[n], published[n])}


@pytest.mark.parametrize("tasks", [ONE, TASKS])
def test_last_layers_are_normal(tasks: tuple[str, ...]) -> None:
    settings: dict[str, Any] = {"tasks": tasks, "demos": ""}
    for make in (
        lambda name: ppo.make_policy(tiny(GAILConfig, "paper", conventions=name, **settings)),
        lambda name: bc.make_policy(BCConfig.preset("paper", conventions=name, **settings)),
    ):
        changed = last_layers(make)
        assert changed
        assert not any("trunk" in name for name in changed)
        values = torch.cat([values.flatten() for values in changed.values()])
        assert abs(float(values.std()) - 1.0) < 0.15
        assert abs(float(values.mean())) < 0.15


def test_a_discriminator_s_last_layer_is_normal_in_multi_task_runs_alone() -> None:
    spreads = []
    for tasks in (ONE, TASKS):
        config = tiny(GAILConfig, "published-code", tasks=tasks, demos="")
        last = make_discriminator(config).last.linear
        spreads.append(torch.cat([last.weight.flatten(), last.bias]).std().item())
    plain = 1.0 / math.sqrt(3.0 * 256)  # of PyTorch's default, uniform within 256 ** -0.5
    assert spreads == pytest.approx([plain, 1.0], rel=0.15)


def test_the_reward_s_floor_follows_the_conventions() -> None:
    rewards = torch.tensor([[1.0], [1.0 + 2e-4]])  # a standard deviation of 1e-4
    spreads = []
    for published in (False, True):
        normaliser = RewardNormaliser(1, 0.01, published=published)
        found = normaliser(rewards, torch.zeros(1, dtype=torch.int64))
        spreads.append(found.std(correction=0).item())
    assert spreads == pytest.approx([0.001, 0.01], rel=1e-3)


def test_the_penalty_is_on_the_gradient_with_respect_to_the_network_s_pixels() -> None:
    weight = torch.linspace(-1.0, 2.0, 6)

    def critic(images: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        logits: Tensor = (2.0 * images - 1.0).flatten(1) @ weight
        return logits

    images, zeros = torch.rand(3, 6, 1, 1), torch.zeros(3, dtype=torch.int64)
    penalty = gradient_penalty(critic, images, zeros, zeros, pixels=(-1.0, 1.0))
    assert penalty.item() == pytest.approx((weight.norm().item() - 1.0) ** 2, rel=1e-5)


@pytest.mark.parametrize(("mode", "forward_passes"), [(False, 1), (True, 2)])
def test_batch_norm_in_the_gradient_penalty(mode: bool, forward_passes: int) -> None:
    critic = make_discriminator(tiny(WGAILGPConfig, demos="", tasks=ONE))
    images, zeros = torch.rand(4, *IMAGE), torch.zeros(4, dtype=torch.int64)
    batch = DiscriminatorBatch(images, zeros, zeros)
    critic_loss(critic, batch, np.random.default_rng(0), 1.0, mode)
    counts = [m.num_batches_tracked for m in critic.modules() if isinstance(m, nn.BatchNorm2d)]
    assert [int(count) for count in counts if count is not None] == [forward_passes] * 3
    assert critic.training
