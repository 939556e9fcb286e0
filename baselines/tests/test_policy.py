"""Trained networks as policies, and runs loaded again."""

import shutil

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import CPU
from magical.errors import CheckpointError, DivergedError, PolicyError, RunFolderError
from magical.evaluation import Policy
from magical.runs.folder import CHECKPOINT
from magical_baselines import NetworkPolicy, is_run, load_policy, train
from magical_baselines.algorithms.bc import BCConfig

IDS = [f"magical/{task}-Demo-v0" for task in TASKS]


class Fixed(nn.Module):
    """Logits from a table, a row a task, plus the image's mean."""

    def __init__(self, logits):
        super().__init__()
        self.logits = logits
        self.seen: list[Tensor] = []

    def forward(self, images, tasks):
        self.seen.append(images)
        return self.logits[tasks]


def fixed(logits, preset="LoRes4E", greedy=False):
    network = Fixed(torch.as_tensor(logits, dtype=torch.float32))
    config = BCConfig.preset("paper", tasks=TASKS, demos="", observation=preset)
    return NetworkPolicy(network, config, CPU, greedy)


def test_actions_are_sampled_from_the_distribution_of_the_right_task():
    logits = torch.full((2, 18), -1e4)
    logits[0, [2, 17]] = torch.tensor([0.25, 0.75]).log()
    logits[1, 5] = 0.0
    policy = fixed(logits)
    assert isinstance(policy, Policy)
    ids = [IDS[0]] * 2000 + [IDS[1]] * 10
    frames = np.zeros((len(ids), 96, 96, 12), np.uint8)
    actions = policy.act(frames, ids, np.random.default_rng(0))
    assert set(actions[:2000]) == {2, 17}
    assert abs((actions[:2000] == 17).mean() - 0.75) < 0.03
    assert (actions[2000:] == 5).all()
    assert actions.dtype == np.int64
    greedy = fixed(logits, greedy=True)
    assert set(greedy.act(frames[:4], ids[:4], np.random.default_rng(0))) == {17}


def test_wrong_observations_and_tasks_are_named():
    policy = fixed(torch.zeros(2, 18))
    rng = np.random.default_rng(0)
    with pytest.raises(PolicyError, match=r"\(B, 96, 96, 12\), found uint8 of shape \(1, 64"):
        policy.act(np.zeros((1, 64, 64, 12), np.uint8), IDS[:1], rng)
    with pytest.raises(PolicyError, match="found float32"):
        policy.act(np.zeros((1, 96, 96, 12), np.float32), IDS[:1], rng)
    with pytest.raises(PolicyError, match="MoveToCorner, MoveToRegion; found magical/FindDupe"):
        policy.act(np.zeros((1, 96, 96, 12), np.uint8), ["magical/FindDupe-Demo-v0"], rng)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("greedy", [False, True])
def test_logits_that_are_not_finite_are_an_error(bad, greedy):
    logits = torch.zeros(2, 18)
    logits[1, 4] = bad
    policy = fixed(logits, greedy=greedy)
    frames = np.zeros((3, 96, 96, 12), np.uint8)
    assert len(policy.act(frames, [IDS[0]] * 3, np.random.default_rng(0))) == 3
    with pytest.raises(DivergedError, match="expected finite outputs"):
        policy.act(frames, [IDS[0], IDS[1], IDS[0]], np.random.default_rng(0))


@pytest.fixture(scope="module")
def run(demos, tmp_path_factory):
    config = BCConfig.preset(
        "quick", tasks=TASKS, demos=str(demos), num_demos=2, batches=2, batch_size=4
    )
    folder = tmp_path_factory.mktemp("policy") / "run"
    train(config, folder)
    return folder


def test_a_run_is_loaded_with_its_observation_and_tasks(run):
    policy = load_policy(run)
    assert isinstance(policy, NetworkPolicy)
    assert is_run(run)
    assert (policy.observation, policy.tasks) == ("LoRes4E", TASKS)
    frames = np.random.default_rng(0).integers(0, 256, (2, 96, 96, 12), dtype=np.uint8)
    once = policy.probabilities(frames, IDS)
    np.testing.assert_array_equal(once, policy.probabilities(frames, IDS))
    np.testing.assert_allclose(once.sum(axis=1), 1.0)
    assert not policy.network.training


def test_folders_that_hold_no_usable_run_are_named(run, tmp_path):
    with pytest.raises(RunFolderError, match="expected a run folder"):
        load_policy(tmp_path)
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    config = (copy / "config.json").read_text()
    (copy / "config.json").write_text(config.replace('"narrow"', '"paper"'))
    with pytest.raises(CheckpointError, match="of another network"):
        load_policy(copy)
    (copy / "config.json").write_text(config)
    (copy / CHECKPOINT).unlink()
    with pytest.raises(CheckpointError, match="expected a readable file, found No such file"):
        load_policy(copy)
    (copy / "config.json").write_text("{")
    with pytest.raises(RunFolderError, match=r"config\.json: expected JSON"):
        load_policy(copy)
