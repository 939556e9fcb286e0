"""Episodes that experts label: what is taken, what is said, what is kept."""

from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.demos import Trajectory, observations
from magical.envs import EnvId
from magical.envs.vector import MagicalVectorEnv
from magical.experts import Memory, expert_for, note_other_action, strategy_seed
from magical.physics import Simulation
from magical.scene import Poses, State
from magical.scene.actions import POINTS
from magical_baselines.algorithms.dagger import collect_labelled

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
    with closing(
        MagicalVectorEnv(
            ENV_IDS, workers=workers, observation="LoRes4E", autoreset_mode="Disabled", copy=False
        )
    ) as envs:
        return collect_labelled(envs, policy, share, np.random.default_rng(seed), round=3), policy


def expert_on(trajectory: Trajectory) -> tuple[list[int], NDArray[np.float64]]:
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
def test_labels_are_the_experts_on_the_states_visited(share: float) -> None:
    trajectories, _ = collect(share)
    assert [t.env_id for t in trajectories] == list(ENV_IDS)
    assert [len(t) for t in trajectories] == [40, 40, 80]
    for trajectory in trajectories:
        labels, poses = expert_on(trajectory)
        assert labels == trajectory.labels.tolist()
        assert np.array_equal(poses, np.asarray(trajectory.poses))


def test_what_is_learned_from_is_what_the_learner_saw() -> None:
    trajectories, policy = collect(0.3)
    for row, trajectory in enumerate(trajectories):
        steps = len(trajectory)
        saw = np.stack(policy.shown)[:steps, row]
        assert np.array_equal(np.asarray(observations(trajectory, "LoRes4E"))[:steps], saw)


def test_the_share_says_whose_actions_are_taken() -> None:
    for trajectory in collect(0.0)[0]:
        assert set(trajectory.actions.tolist()) == {FORWARD_LEFT}
    for trajectory in collect(1.0)[0]:
        assert np.array_equal(trajectory.actions, trajectory.labels)
    taken, wanted = (
        np.concatenate(parts)
        for parts in zip(*((t.actions, t.labels) for t in collect(0.25)[0]), strict=True)
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
        assert np.array_equal(a.labels, b.labels)


def test_the_metadata_says_where_an_episode_comes_from() -> None:
    trajectory = collect(0.5)[0][0]
    assert trajectory.demonstrator == "dagger"
    assert (trajectory.metadata["round"], trajectory.metadata["expert_share"]) == (3, 0.5)
    assert {"versions", "recorded"} <= set(trajectory.metadata)
