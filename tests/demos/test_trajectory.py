"""Trajectories: what does not fit is refused, and observations are the environment's."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical.demos import Actor, Frames, Trajectory, observations
from magical.demos.trajectory import replay
from magical.envs.env import MagicalEnv
from magical.errors import InvalidSceneError, TrajectoryError, UnknownNameError
from magical.observe import PRESETS, PixelSpec
from magical.scene import Poses, to_continuous
from magical.tasks import get_task
from tests.demos.conftest import make_frames_trajectory, make_trajectory

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
    assert (trajectory.actions.tolist(), trajectory.actions.dtype) == ([1, 17], np.int64)
    assert not trajectory.bodies.any()
    with pytest.raises(ValueError, match="read-only"):
        trajectory.bodies[0] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"actions": np.array([1, 18])}, r"from 0 to 17 of shape \(2,\), found 18 in row 1"),
        ({"actions": np.array([], np.int64)}, "at least one"),
        ({"actions": np.full((2, 3), 1.5)}, "found drive 1.5 in row 0"),
        ({"expert_actions": np.zeros((2, 3))}, r"expert_actions: .* of shape \(2,\)"),
        ({"policy_actions": np.array([-1, 1])}, "policy_actions: .* found -1 in row 0"),
        ({"bodies": BODIES[:, :5]}, "and the scene"),
        ({"bodies": BODIES.astype(np.float32)}, "float32"),
        ({"bodies": BODIES + np.nan}, "finite"),
        ({"bodies": BODIES + 11.0}, r"finite x, y and angles of at most .* found \[11"),
        ({"bodies": BODIES + np.array([0, 0, 0, np.inf, 0, 0])}, "velocities of at most"),
        (FRAMES_ONLY, "expected bodies or frames, found none"),
        ({**FRAMES_ONLY, "frames": {"top": FRAMES}}, "views"),
        ({**FRAMES_ONLY, "frames": {"ego": FRAMES[:2]}}, "for 2 actions"),
        ({"actors": np.array([0])}, r"actors: expected uint8 \(2,\)"),
        ({"actors": np.array([0, 3])}, "actors: expected at most 2"),
    ],
)
def test_a_part_that_does_not_fit_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(**{**GOOD, **change})


def test_scenes_and_environments_that_do_not_exist_are_refused() -> None:
    scene = replace(GOOD["scene"], robot=GOOD["scene"].robot._replace(x=1.2))
    with pytest.raises(InvalidSceneError, match="outside the workspace"):
        Trajectory(**{**GOOD, "scene": scene})
    with pytest.raises(UnknownNameError, match="MoveToCorner"):
        Trajectory(**{**GOOD, "env_id": "magical/MoveToCornr-Demo-v0"})


def test_labels_are_the_experts_actions_and_a_policys_steps_are_not_demonstrated() -> None:
    plain = Trajectory(**{**GOOD, "env_id": "MoveToCorner-TestAll-LoRes4E-v0"})
    assert plain.env_id == "magical/MoveToCorner-TestAll-v0"  # without the preset
    assert (plain.labels.tolist(), plain.is_demonstrated.tolist()) == ([1, 2], [True, True])
    labelled = replace(plain, expert_actions=np.array([3, 2], np.uint8))
    assert (labelled.actions.tolist(), labelled.labels.tolist()) == ([1, 2], [3, 2])
    assert labelled.is_intended.tolist() == [False, True]
    watched = replace(plain, actors=np.array([Actor.POLICY, Actor.HUMAN]))
    assert watched.is_demonstrated.tolist() == watched.is_intended.tolist() == [False, True]
    relabelled = replace(watched, expert_actions=np.array([1, 2]))
    assert relabelled.is_demonstrated.tolist() == [True, True]


def test_from_bodies_scores_by_both_rules() -> None:
    task = get_task("ClusterColour")
    start = Poses.at_rest(task.demo)
    poses = np.stack([start.bodies] * 2)
    made = Trajectory.from_bodies("ClusterColour-Demo-v0", task.demo, [0], poses)
    assert made.score == task.score(task.demo, start)
    assert made.published_code_score == task.published_code_score(task.demo, start)
    assert np.isnan(made.bodies[..., 3:]).all()
    for wrong in (poses[0], poses[:, :-1], poses[..., None]):
        with pytest.raises(TrajectoryError, match="bodies: expected"):
            Trajectory.from_bodies("ClusterColour-Demo-v0", task.demo, [0], wrong)


def test_actions_are_converted_to_those_that_move_everything_the_same() -> None:
    plain = make_trajectory(expert_actions=np.arange(12), policy_actions=np.arange(12))
    points = plain.with_action_space("continuous")
    for name in ("actions", "expert_actions", "policy_actions"):
        np.testing.assert_array_equal(getattr(points, name), to_continuous(getattr(plain, name)))
    assert replay(points).departure == replay(plain).departure == 0.0
    assert points.with_action_space("discrete").actions.tolist() == plain.actions.tolist()
    between = replace(points, actions=np.full((12, 3), 0.5))
    with pytest.raises(TrajectoryError, match="18 discrete actions"):
        between.with_action_space("discrete")


OWN = PixelSpec((("ego", 2), ("allo", 3)), size=40, samples=2)


@pytest.mark.parametrize("observation", [*PRESETS, "raw", "state", OWN])
def test_observations_are_bit_identical(observation: Any) -> None:
    trajectory = make_trajectory("ClusterShape-TestAll-v0", steps=7)
    env_id = trajectory.env_id
    running = MagicalEnv(env_id.task, env_id.variant, observation=observation)
    start = {"scene": trajectory.scene, "dynamics": trajectory.dynamics}
    expected = [running.reset(options=start)[0]]
    expected += [running.step(action)[0] for action in trajectory.actions.tolist()]
    for times in (None, [6, 0]):
        found = observations(trajectory, observation, times)
        for row, time in enumerate(range(8) if times is None else times):
            single = {v: a[row] for v, a in found.items()} if type(found) is dict else found[row]
            np.testing.assert_equal(single, expected[time])
    for wrong in ([0, 8], [-1]):
        with pytest.raises(TrajectoryError, match="expected 0 to 7, found"):
            observations(trajectory, observation, wrong)


@pytest.mark.parametrize("preset", PRESETS)
def test_recorded_frames_give_the_low_resolution_presets(preset: str) -> None:
    with_poses = make_trajectory("magical/FixColour-TestAll-v0")
    frames = observations(with_poses, PixelSpec((("ego", 1), ("allo", 1)), separate=True))
    recorded = replace(with_poses, frames=frames, bodies=None, score=None)
    np.testing.assert_equal(observations(recorded, preset), observations(with_poses, preset))


@pytest.mark.parametrize("observation", ["raw", "state", PixelSpec(samples=1), {"size": 48}])
def test_recorded_frames_give_no_other_observation(observation: Any) -> None:
    recorded = make_frames_trajectory()
    with pytest.raises(TrajectoryError, match=r"recording of|only frames"):
        observations(recorded, observation)
    ego = replace(recorded, frames={"ego": recorded.frames["ego"]})
    with pytest.raises(TrajectoryError, match="not allo frames"):
        observations(ego, "LoRes3EA")


def test_states_need_velocities_and_views_a_name() -> None:
    good = make_trajectory()
    poses = Trajectory.from_bodies(good.env_id, good.scene, good.actions, good.poses)
    np.testing.assert_equal(observations(poses, "LoRes4E"), observations(good, "LoRes4E"))
    with pytest.raises(TrajectoryError, match="expected poses and velocities"):
        observations(poses, "state")
    with pytest.raises(UnknownNameError, match="expected one of: ego, allo"):
        Frames(good, "egoo")
