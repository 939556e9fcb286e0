"""Several networks as one policy."""

from pathlib import Path

import numpy as np
import pytest
import torch

from magical.envs import EnvId
from magical.errors import PolicyError
from magical.evaluation import Policy, environments, evaluate
from magical.learning import EnsemblePolicy, NetworkPolicy, load_policy, train
from magical.learning.algorithms.bc import BCConfig
from tests.learning.test_policy import IDS, fixed
from tests.learning.tiny_runs import tiny


def test_actions_follow_the_mean_of_the_distributions() -> None:
    logits = torch.full((2, 2, 18), -1e4)
    logits[0, :, 2] = 0.0
    logits[1, :, 17] = 0.0
    policy = EnsemblePolicy([fixed(logits[0]), fixed(logits[1])])
    assert isinstance(policy, Policy)
    frames = np.zeros((1000, 96, 96, 12), np.uint8)
    probabilities = policy.probabilities(frames, [IDS[0]] * 1000)
    np.testing.assert_allclose(probabilities[0, [2, 17]], 0.5)
    actions = policy.act(frames, [IDS[0]] * 1000, np.random.default_rng(0))
    assert set(actions) == {2, 17}
    assert abs((actions == 2).mean() - 0.5) < 0.04


def test_runs_are_loaded_and_evaluated(demos: Path, tmp_path: Path) -> None:
    env_id = EnvId("MoveToRegion", "Demo")
    for seed in (0, 1):
        train(tiny(BCConfig, demos=str(demos), seed=seed), tmp_path / str(seed))
    policy = EnsemblePolicy.load([tmp_path / "0", tmp_path / "1"])
    assert len(evaluate(policy, environments(["MoveToRegion"], ["Demo"]), rollouts=2)) == 2
    frames = np.zeros((1, 96, 96, 12), np.uint8)
    loaded = [load_policy(tmp_path / seed) for seed in "01"]
    single = [
        member.probabilities(frames, [str(env_id)])
        for member in loaded
        if isinstance(member, NetworkPolicy)
    ]
    expected = (single[0] + single[1]) / 2
    np.testing.assert_allclose(policy.probabilities(frames, [str(env_id)]), expected)


def test_members_with_different_observations_are_an_error() -> None:
    logits = torch.zeros(2, 18)
    with pytest.raises(PolicyError, match="one observation, found LoRes4A, LoRes4E"):
        EnsemblePolicy([fixed(logits), fixed(logits, "LoRes4A")])
    with pytest.raises(PolicyError, match="found none"):
        EnsemblePolicy([])


def test_the_tasks_are_those_of_all_members() -> None:
    members = [fixed(torch.zeros(2, 18)) for _ in range(2)]
    members[1].tasks = ("MakeLine", *members[0].tasks[:1])
    assert EnsemblePolicy(members).tasks == members[0].tasks[:1]
    members[1].tasks = ("MakeLine",)
    with pytest.raises(PolicyError, match="a task in common"):
        EnsemblePolicy(members)
