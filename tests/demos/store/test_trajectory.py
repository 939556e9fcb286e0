"""Trajectories check their parts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical.demos import Actor, Trajectory
from magical.errors import InvalidSceneError, TrajectoryError, UnknownNameError
from magical.scene import Poses
from magical.tasks import get_task

POSES = np.zeros((3, 6, 3))
FRAMES = np.zeros((3, 96, 96, 3), np.uint8)
GOOD: dict[str, Any] = {
    "env_id": "magical/MoveToCorner-Demo-v0",
    "scene": get_task("MoveToCorner").demo,
    "actions": np.array([1, 2]),
    "poses": POSES,
    "score": 0.5,
    "published_code_score": 0.5,
}


def test_trajectory_copies_its_arrays_and_is_read_only() -> None:
    actions, poses = np.array([1, 17]), POSES.copy()
    trajectory = Trajectory(**{**GOOD, "actions": actions, "poses": poses})
    actions[0], poses[0] = 3, 9.0
    assert trajectory.actions.tolist() == [1, 17]
    assert trajectory.actions.dtype == np.int64
    assert trajectory.poses is not None
    assert not trajectory.poses.any()
    assert len(trajectory) == 2
    with pytest.raises(ValueError, match="read-only"):
        trajectory.poses[0] = 1.0
    with pytest.raises(AttributeError):
        trajectory.seed = 3  # type: ignore[misc]


def test_labels_are_the_experts_actions_where_it_has_others() -> None:
    assert Trajectory(**GOOD).labels.tolist() == [1, 2]
    labelled = Trajectory(**GOOD, expert_actions=np.array([3, 2], np.uint8))
    assert labelled.actions.tolist() == [1, 2]
    assert labelled.labels.tolist() == [3, 2]
    assert labelled.labels.dtype == np.int64
    with pytest.raises(ValueError, match="read-only"):
        labelled.labels[0] = 1


def test_preset_is_dropped_from_the_id() -> None:
    trajectory = Trajectory(**{**GOOD, "env_id": "MoveToCorner-TestAll-LoRes4E-v0"})
    assert trajectory.env_id == "magical/MoveToCorner-TestAll-v0"
    assert (trajectory.task.name, trajectory.env_id.variant) == ("MoveToCorner", "TestAll")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"actions": np.array([1, 18])}, "from 0 to 17, found 18 in row 1"),
        ({"actions": np.array([-1, 2])}, "from 0 to 17"),
        ({"actions": np.array([1.0, 2.0])}, "expected 2 integers"),
        ({"actions": np.array([], np.int64)}, "at least one"),
        ({"actions": np.array([[1, 2]])}, r"\(1, 2\)"),
        ({"actions": np.array([1, 2, 3])}, "for 3 actions"),
        ({"expert_actions": np.array([1])}, "expert_actions: expected 2 integers"),
        ({"expert_actions": np.array([1, 18])}, "expert_actions: .* found 18 in row 1"),
        ({"expert_actions": np.array([1.0, 2.0])}, "expert_actions: expected 2 integers"),
        ({"expert_actions": np.array([[1, 2]])}, r"\(1, 2\)"),
        ({"poses": POSES[:2]}, "expected float64"),
        ({"poses": POSES[:, :5]}, "1 blocks"),
        ({"poses": POSES.astype(np.float32)}, "float32"),
        ({"poses": POSES + np.nan}, "finite"),
        ({"poses": POSES + 11.0}, r"finite x, y and angles of at most .* found \[11"),
        ({"velocities": POSES[:2]}, "velocities: expected float64"),
        ({"velocities": POSES + np.inf}, "velocities: expected finite"),
        ({"poses": None, "frames": {"ego": FRAMES}, "velocities": POSES}, "none without poses"),
        ({"poses": None}, "expected poses or frames, found none"),
        ({"poses": None, "frames": {"top": FRAMES}}, "views"),
        ({"poses": None, "frames": {}}, "views"),
        ({"poses": None, "frames": {"ego": FRAMES[:2]}}, "one more than the 2 actions"),
        ({"poses": None, "frames": {"ego": FRAMES.astype(int)}}, "uint8"),
        ({"score": 1.5}, "score: expected a number from 0 to 1"),
        ({"score": None}, "from_poses"),
        ({"policy_actions": np.array([1])}, "policy_actions: expected 2 integers"),
        ({"policy_actions": np.array([-1, 1])}, "policy_actions: .* found -1 in row 0"),
        ({"actors": np.array([0])}, "actors: .* one for each of 2 actions"),
        ({"actors": np.array([0, 3])}, "actors: expected numbers of policy, expert, human"),
        ({"published_code_score": None}, "published_code_score"),
        ({"published_code_score": float("nan")}, "nan"),
        ({"seed": -1}, "seed"),
        ({"demonstrator": ""}, "demonstrator"),
        ({"metadata": {"a": object()}}, "plain JSON"),
        ({"metadata": {"a": float("inf")}}, "plain JSON"),
    ],
)
def test_invalid_part_is_refused(change: dict[str, Any], message: str) -> None:
    Trajectory(**GOOD)
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(**{**GOOD, **change})


def test_a_policys_own_steps_are_not_demonstrated() -> None:
    assert Trajectory(**GOOD).is_demonstrated.tolist() == [True, True]
    actors = np.array([Actor.POLICY, Actor.HUMAN])
    assert Trajectory(**GOOD, actors=actors).is_demonstrated.tolist() == [False, True]
    relabelled = Trajectory(**GOOD, actors=actors, expert_actions=np.array([1, 2]))
    assert relabelled.is_demonstrated.tolist() == [True, True]


def test_intended_are_demonstrators_choices_that_were_executed() -> None:
    perturbed = Trajectory(**GOOD, expert_actions=np.array([1, 3]))
    assert perturbed.is_intended.tolist() == [True, False]
    actors = np.array([Actor.POLICY, Actor.HUMAN])
    assert Trajectory(**GOOD, actors=actors).is_intended.tolist() == [False, True]


def test_scene_that_no_episode_can_start_from_is_refused() -> None:
    scene = replace(GOOD["scene"], robot=GOOD["scene"].robot._replace(x=1.2))
    with pytest.raises(ValueError, match="outside the workspace"):
        Trajectory(**{**GOOD, "scene": scene})


def test_unknown_environment() -> None:
    with pytest.raises(UnknownNameError, match="MoveToCorner"):
        Trajectory(**{**GOOD, "env_id": "magical/MoveToCornr-Demo-v0"})


def test_from_poses_scores_by_both_rules() -> None:
    task = get_task("ClusterColour")
    poses = np.stack([Poses.at_rest(task.demo).bodies] * 2)
    made = Trajectory.from_poses("ClusterColour-Demo-v0", task.demo, [0], poses)
    assert made.score == task.score(task.demo, Poses.at_rest(task.demo))
    assert made.published_code_score == task.published_code_score(
        task.demo, Poses.at_rest(task.demo)
    )
    for wrong in (poses[0], poses[:, :-1], poses[..., None]):
        with pytest.raises(TrajectoryError, match="shape"):
            Trajectory.from_poses("ClusterColour-Demo-v0", task.demo, [0], wrong)
    with pytest.raises(InvalidSceneError, match="FindDupe: expected at most 7 blocks"):
        Trajectory.from_poses("FindDupe-Demo-v0", task.demo, [0], poses)


def test_a_trajectory_is_printed_in_a_line() -> None:
    expected = "Trajectory('magical/MoveToCorner-Demo-v0', 2 steps, score 0.5, by 'unknown')"
    assert repr(Trajectory(**GOOD)) == expected
