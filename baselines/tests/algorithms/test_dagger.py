"""DAgger from beginning to end, in the smallest runs."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.tests import tiny_runs
from baselines.tests.tiny_runs import assert_same, checkpoint
from magical.demos import Dataset, DatasetWriter
from magical.envs import EnvId
from magical.envs.vector import MagicalVectorEnv
from magical.errors import DatasetError
from magical.experts import Memory, expert_for, note_other_action, strategy_seed
from magical.physics import Simulation
from magical.runs import read_metrics
from magical.scene import POINTS, Poses, State
from magical_baselines import train
from magical_baselines.algorithms.dagger import AGGREGATE, DAggerConfig, collect_labelled


def tiny(demos, **fields):
    settings = {"rounds": 3, "batches": 2, "batch_size": 3, "network": "light", "log_every": 1}
    every: dict[str, Any] = {**settings, "demos": str(demos), "checkpoint_every": 1}
    return tiny_runs.tiny(DAggerConfig, **{**every, **fields})


def assert_same_run(first, second):
    """Equal weights, optimisers and episodes; files differ in the time of recording."""
    a, b = ({**checkpoint(folder), "aggregate": None} for folder in (first, second))
    assert_same(a, b)
    for left, right in zip(aggregate(first), aggregate(second), strict=True):
        assert left.actions.tolist() == right.actions.tolist()
        assert left.labels.tolist() == right.labels.tolist()


def aggregate(folder):
    return Dataset.open(folder / AGGREGATE)


@pytest.fixture(scope="module")
def whole(demos, tmp_path_factory):
    """A run that was never stopped."""
    folder = tmp_path_factory.mktemp("dagger") / "run"
    assert train(tiny(demos), folder).finished
    return folder


def test_the_aggregate_is_a_dataset_like_others(whole):
    dataset = aggregate(whole)
    assert {entry.env_id for entry in dataset.entries} == {"magical/MoveToRegion-Demo-v0"}
    assert [t.metadata["round"] for t in dataset] == [1, 2]
    assert [t.metadata["expert_share"] for t in dataset] == [0.5, 0.25]
    assert [len(trajectory) for trajectory in dataset] == [40, 40]
    first, second = dataset
    assert first.seed != second.seed


def test_reports_count_the_experts_labels(whole):
    rows = read_metrics(whole)
    assert [row["step"] for row in rows] == [1, 2, 3, 4, 5, 6]
    assert [row["round"] for row in rows] == [0, 0, 1, 1, 2, 2]
    assert [row["expert_share"] for row in rows] == [1.0, 1.0, 0.5, 0.5, 0.25, 0.25]
    # 12 actions in each of two demonstrations, then 40 in each episode
    assert [row["labels"] for row in rows[::2]] == [24, 64, 104]
    assert all(row["samples"] < row["labels"] for row in rows)
    assert "score" not in rows[0]
    scores = [entry.final_score for entry in aggregate(whole).entries]
    assert [row["score"] for row in rows[2::2]] == pytest.approx(scores, abs=1e-6)


def test_a_round_that_was_cut_short_while_stored_is_completed(demos, tmp_path, monkeypatch):
    config = tiny(demos, episodes=2)
    append = DatasetWriter.append

    def full_after_three(self, trajectory):
        if len(aggregate(self.path.parent)) == 3:
            raise DatasetError("the disk is full")
        return append(self, trajectory)

    with monkeypatch.context() as patch:
        patch.setattr(DatasetWriter, "append", full_after_three)
        with pytest.raises(DatasetError):
            train(config, tmp_path / "run")
    assert len(aggregate(tmp_path / "run")) == 3
    assert train(config, tmp_path / "run", resume=True).finished
    train(config, tmp_path / "whole")
    assert_same_run(tmp_path / "run", tmp_path / "whole")


ENV_IDS = (
    EnvId("MoveToRegion", "Demo"),
    EnvId("MoveToRegion", "TestAll"),
    EnvId("MoveToCorner", "TestDynamics"),
)
FORWARD_LEFT = 4


class Stubborn:
    """Always does the same; keeps what it was shown."""

    observation = "LoRes4E"

    def __init__(self):
        self.shown: list[NDArray[np.uint8]] = []

    def reset(self, mask):
        self.shown.clear()

    def act(self, shown, env_ids, rng):
        self.shown.append(shown.copy())
        return np.full(len(env_ids), FORWARD_LEFT)


def collect(share, seed=0, workers=0):
    policy = Stubborn()
    with closing(
        MagicalVectorEnv(
            ENV_IDS, workers=workers, observation="LoRes4E", autoreset_mode="Disabled", copy=False
        )
    ) as envs:
        return collect_labelled(envs, policy, share, np.random.default_rng(seed), round=3), policy


def expert_on(trajectory):
    """The expert's labels along an episode that is simulated again, and the episode's poses."""
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    seed = strategy_seed(trajectory.env_id.variant, trajectory.seed)
    expert, memory = expert_for(trajectory.task.name, seed=seed), Memory()
    labels, poses = [], [simulation.read()[:, :3].copy()]
    for step, action in enumerate(trajectory.actions.tolist()):
        table = simulation.read()
        state = State(
            trajectory.scene, Poses(table[:, :3]), table[:, 3:], step, trajectory.task.horizon
        )
        label, memory = expert.act(state, memory)
        memory = memory if label == action else note_other_action(memory, action)
        labels.append(label)
        simulation.step(POINTS[action])
        poses.append(simulation.read()[:, :3].copy())
    return labels, np.stack(poses)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_labels_are_the_experts_on_the_states_visited(share):
    trajectories, _ = collect(share)
    assert [t.env_id for t in trajectories] == list(ENV_IDS)
    assert [len(t) for t in trajectories] == [40, 40, 80]
    for trajectory in trajectories:
        labels, poses = expert_on(trajectory)
        assert labels == trajectory.labels.tolist()
        assert np.array_equal(poses, np.asarray(trajectory.poses))
