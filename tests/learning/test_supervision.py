"""Episodes that experts label: what is taken, what is said, what is kept."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.demos import Trajectory, observations
from magical.envs import EnvId
from magical.errors import DemonstrationsError
from magical.experts import expert_for
from magical.learning.supervision import LABELS, LabelledEpisodes, relabel
from magical.physics import Simulation
from magical.scene import Poses, State

ENV_IDS = (
    EnvId("MoveToRegion", "Demo"),
    EnvId("MoveToRegion", "TestAll"),
    EnvId("MoveToCorner", "TestDynamics"),
)
FORWARD_LEFT = 4


class Stubborn:
    """Always does the same; keeps what it was shown."""

    observation = "LoRes4E"

    def __init__(self) -> None:
        self.shown: list[NDArray[np.uint8]] = []

    def reset(self, mask: NDArray[np.bool_]) -> None:
        self.shown.clear()

    def act(self, shown: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Any:
        self.shown.append(shown.copy())
        return np.full(len(env_ids), FORWARD_LEFT)


def collect(share: float, seed: int = 0, workers: int = 0) -> tuple[list[Trajectory], Stubborn]:
    policy = Stubborn()
    with LabelledEpisodes(ENV_IDS, "LoRes4E", workers) as episodes:
        rng = np.random.default_rng(seed)
        return episodes.collect(policy, share, rng, round=3), policy


def labels_of(trajectory: Trajectory) -> NDArray[np.int64]:
    return np.array(trajectory.metadata[LABELS])


def expert_on(trajectory: Trajectory) -> tuple[list[int], NDArray[np.float64]]:
    """The expert's labels along an episode that is simulated again, and the episode's poses."""
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    expert, memory = expert_for(trajectory.task.name, seed=trajectory.seed), None
    labels, poses = [], [simulation.read()[:, :3].copy()]
    for step, action in enumerate(trajectory.actions.tolist()):
        table = simulation.read().copy()
        state = State(
            trajectory.scene, Poses(table[:, :3]), table[:, 3:], step, trajectory.task.horizon
        )
        label, memory = expert.act(state, memory)
        labels.append(label)
        simulation.step(action)
        poses.append(simulation.read()[:, :3].copy())
    return labels, np.stack(poses)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_labels_are_the_experts_on_the_states_visited(share: float) -> None:
    trajectories, _ = collect(share)
    assert [t.env_id for t in trajectories] == list(ENV_IDS)
    assert [len(t) for t in trajectories] == [40, 40, 80]
    for trajectory in trajectories:
        labels, poses = expert_on(trajectory)
        assert labels == labels_of(trajectory).tolist()
        assert np.array_equal(poses, np.asarray(trajectory.poses))


def test_what_is_learned_from_is_what_the_learner_saw() -> None:
    trajectories, policy = collect(0.3)
    for row, trajectory in enumerate(trajectories):
        steps = len(trajectory)
        saw = np.stack(policy.shown)[:steps, row]
        assert np.array_equal(np.asarray(observations(relabel(trajectory), "LoRes4E"))[:steps], saw)
        assert np.array_equal(relabel(trajectory).actions, labels_of(trajectory))


def test_the_share_says_whose_actions_are_taken() -> None:
    for trajectory in collect(0.0)[0]:
        assert set(trajectory.actions.tolist()) == {FORWARD_LEFT}
    for trajectory in collect(1.0)[0]:
        assert np.array_equal(trajectory.actions, labels_of(trajectory))
    taken, wanted = (
        np.concatenate(parts)
        for parts in zip(*((t.actions, labels_of(t)) for t in collect(0.25)[0]), strict=True)
    )
    differ = wanted != FORWARD_LEFT
    assert 0.1 < (taken == wanted)[differ].mean() < 0.4
    assert set(taken[taken != wanted].tolist()) == {FORWARD_LEFT}


def test_episodes_follow_from_the_generator_alone() -> None:
    first, again, other = collect(0.5)[0], collect(0.5, workers=2)[0], collect(0.5, seed=1)[0]
    for a, b, c in zip(first, again, other, strict=True):
        assert np.array_equal(a.actions, b.actions)
        assert np.array_equal(np.asarray(a.poses), np.asarray(b.poses))
        assert a.seed == b.seed != c.seed
        assert a.metadata[LABELS] == b.metadata[LABELS]


def test_the_metadata_says_where_an_episode_comes_from() -> None:
    trajectory = collect(0.5)[0][0]
    assert trajectory.demonstrator == "dagger"
    assert (trajectory.metadata["round"], trajectory.metadata["expert_share"]) == (3, 0.5)
    assert {"versions", "recorded"} <= set(trajectory.metadata)


@pytest.mark.parametrize("labels", [None, [1, 2], "text", [18] * 40, [-1] * 40, [0.5] * 40])
def test_labels_that_do_not_fit_are_named(labels: Any) -> None:
    trajectory = collect(1.0)[0][0]
    damaged = replace(trajectory, metadata={LABELS: labels} if labels is not None else {})
    with pytest.raises(DemonstrationsError, match="expected 40 actions in the metadata"):
        relabel(damaged)
