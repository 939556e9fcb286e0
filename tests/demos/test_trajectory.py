"""Trajectories check what may come from a file of others."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical.demos import Actor, Trajectory
from magical.errors import InvalidSceneError, TrajectoryError, UnknownNameError
from magical.physics import Simulation
from magical.scene import Poses, to_continuous
from magical.tasks import get_task
from tests.demos.conftest import MakeTrajectory

BODIES = np.zeros((3, 6, 6))
FRAMES = np.zeros((3, 96, 96, 3), np.uint8)
GOOD: dict[str, Any] = {
    "env_id": "magical/MoveToCorner-Demo-v0",
    "scene": get_task("MoveToCorner").demo,
    "actions": np.array([1, 2]),
    "bodies": BODIES,
    "score": 0.5,
    "published_code_score": 0.5,
}
FRAMES_ONLY = {"bodies": None, "score": None}


def test_a_trajectory_copies_its_arrays_and_is_read_only() -> None:
    actions, bodies = np.array([1, 17]), BODIES.copy()
    trajectory = Trajectory(**{**GOOD, "actions": actions, "bodies": bodies})
    actions[0], bodies[0] = 3, 9.0
    assert trajectory.actions.tolist() == [1, 17]
    assert trajectory.actions.dtype == np.int64
    assert not trajectory.bodies.any()
    with pytest.raises(ValueError, match="read-only"):
        trajectory.bodies[0] = 1.0


def test_preset_is_dropped_from_the_id() -> None:
    trajectory = Trajectory(**{**GOOD, "env_id": "MoveToCorner-TestAll-LoRes4E-v0"})
    assert trajectory.env_id == "magical/MoveToCorner-TestAll-v0"
    assert repr(trajectory).startswith("Trajectory('magical/MoveToCorner-TestAll-v0', 2 steps")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"actions": np.array([1, 18])}, r"from 0 to 17 of shape \(2,\), found 18 in row 1"),
        ({"actions": np.array([1.0, 2.0])}, r"expected integers .* of shape \(2,\)"),
        ({"actions": np.array([], np.int64)}, "at least one"),
        ({"actions": np.array([[1, 2]])}, "of shape"),
        ({"actions": np.full((2, 3), 1.5)}, "found drive 1.5 in row 0"),
        ({"actions": np.array([1, 2, 3])}, "for 3 actions"),
        ({"expert_actions": np.array([1])}, r"expert_actions: .* of shape \(2,\)"),
        ({"expert_actions": np.zeros((2, 3))}, r"expert_actions: .* of shape \(2,\)"),
        ({"bodies": BODIES[:2]}, "expected float64"),
        ({"bodies": BODIES[:, :5]}, "and the scene"),
        ({"bodies": BODIES[..., :3]}, "expected float64"),
        ({"bodies": BODIES.astype(np.float32)}, "float32"),
        ({"bodies": BODIES + np.nan}, "finite"),
        ({"bodies": BODIES + 11.0}, r"finite x, y and angles of at most .* found \[11"),
        ({"bodies": BODIES + np.array([0, 0, 0, np.inf, 0, 0])}, "velocities of at most"),
        (FRAMES_ONLY, "expected bodies or frames, found none"),
        ({**FRAMES_ONLY, "frames": {"top": FRAMES}}, "views"),
        ({**FRAMES_ONLY, "frames": {}}, "found none"),
        ({**FRAMES_ONLY, "frames": {"ego": FRAMES[:2]}}, "for 2 actions"),
        ({**FRAMES_ONLY, "frames": {"ego": FRAMES.astype(int)}}, "uint8"),
        ({"policy_actions": np.array([-1, 1])}, "policy_actions: .* found -1 in row 0"),
        ({"actors": np.array([0])}, r"actors: expected uint8 \(2,\)"),
        ({"actors": np.array([0, 3])}, "actors: expected at most 2"),
    ],
)
def test_a_part_that_does_not_fit_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(**{**GOOD, **change})


def test_labels_are_the_experts_actions_where_it_has_others() -> None:
    assert Trajectory(**GOOD).labels.tolist() == [1, 2]
    labelled = Trajectory(**GOOD, expert_actions=np.array([3, 2], np.uint8))
    assert (labelled.actions.tolist(), labelled.labels.tolist()) == ([1, 2], [3, 2])
    assert labelled.is_intended.tolist() == [False, True]


def test_a_policys_own_steps_are_not_demonstrated() -> None:
    assert Trajectory(**GOOD).is_demonstrated.tolist() == [True, True]
    actors = np.array([Actor.POLICY, Actor.HUMAN])
    watched = Trajectory(**GOOD, actors=actors)
    assert watched.is_demonstrated.tolist() == watched.is_intended.tolist() == [False, True]
    relabelled = replace(watched, expert_actions=np.array([1, 2]))
    assert relabelled.is_demonstrated.tolist() == [True, True]


def test_scenes_and_environments_that_do_not_exist_are_refused() -> None:
    scene = replace(GOOD["scene"], robot=GOOD["scene"].robot._replace(x=1.2))
    with pytest.raises(InvalidSceneError, match="outside the workspace"):
        Trajectory(**{**GOOD, "scene": scene})
    with pytest.raises(UnknownNameError, match="MoveToCorner"):
        Trajectory(**{**GOOD, "env_id": "magical/MoveToCornr-Demo-v0"})


def test_from_bodies_scores_by_both_rules() -> None:
    task = get_task("ClusterColour")
    poses = np.stack([Poses.at_rest(task.demo).bodies] * 2)
    made = Trajectory.from_bodies("ClusterColour-Demo-v0", task.demo, [0], poses)
    start = Poses.at_rest(task.demo)
    assert made.score == task.score(task.demo, start)
    assert made.published_code_score == task.published_code_score(task.demo, start)
    assert np.isnan(made.bodies[..., 3:]).all()
    for wrong in (poses[0], poses[:, :-1], poses[..., None]):
        with pytest.raises(TrajectoryError, match="bodies: expected"):
            Trajectory.from_bodies("ClusterColour-Demo-v0", task.demo, [0], wrong)


def test_actions_are_converted_to_those_that_move_everything_the_same(
    make_trajectory: MakeTrajectory,
) -> None:
    plain = make_trajectory(expert_actions=np.arange(12), policy_actions=np.arange(12))
    points = plain.with_action_space("continuous")
    for name in ("actions", "expert_actions", "policy_actions"):
        np.testing.assert_array_equal(getattr(points, name), to_continuous(getattr(plain, name)))
    simulation = Simulation(points.scene, points.dynamics)
    for action in points.actions.tolist():
        simulation.step(action)
    np.testing.assert_array_equal(simulation.read(), plain.bodies[-1])
    back = points.with_action_space("discrete")
    assert back.actions.tolist() == plain.actions.tolist()
    between = replace(points, actions=np.full((12, 3), 0.5))
    with pytest.raises(TrajectoryError, match="18 discrete actions"):
        between.with_action_space("discrete")
