"""Observations of a stored trajectory are those that the environment returned."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.demos import (
    Dataset,
    Frames,
    RecordTrajectories,
    Trajectory,
    observations,
)
from magical.errors import TrajectoryError, UnknownNameError
from magical.observe import PRESETS, PixelSpec
from tests.demos.conftest import MakeTrajectory

STEPS = 7
OBSERVATIONS: dict[str, Any] = {
    **{preset: preset for preset in PRESETS},
    "raw": "raw",
    "state": "state",
    "own": PixelSpec((("ego", 2), ("allo", 3)), size=40, samples=2),
}


def assert_same(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert set(a) == set(b)
        for view in a:
            assert_same(a[view], b[view])
    else:
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


def joined(values: list[Any], join: Callable[..., Any] = np.stack) -> Any:
    if isinstance(values[0], dict):
        return {view: join([value[view] for value in values]) for view in values[0]}
    return join(values)


@pytest.mark.parametrize("env", ["MoveToCorner-TestAll", "ClusterShape-TestAll"])
@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_observations_are_bit_identical(tmp_path: Path, env: str, observation: str) -> None:
    made = gymnasium.make(f"magical/{env}-v0", observation=OBSERVATIONS[observation], horizon=STEPS)
    recorder = RecordTrajectories(made, tmp_path / "d", demonstrator="random")
    rng = np.random.default_rng(3)
    returned = [recorder.reset(seed=5)[0]]
    returned += [recorder.step(int(rng.integers(18)))[0] for _ in range(STEPS)]
    (trajectory,) = Dataset.open(tmp_path / "d")
    assert_same(observations(trajectory, OBSERVATIONS[observation]), joined(returned))
    assert_same(
        observations(trajectory, OBSERVATIONS[observation], [6, 0]),
        joined([returned[6], returned[0]]),
    )


def test_time_steps_outside_the_episode_are_refused(make_trajectory: MakeTrajectory) -> None:
    trajectory = make_trajectory()
    with pytest.raises(TrajectoryError, match="expected 0 to 12, found 0 to 13"):
        observations(trajectory, times=[0, 13])
    with pytest.raises(TrajectoryError, match="0 to 12"):
        observations(trajectory, times=[-1])


@pytest.mark.parametrize("preset", PRESETS)
def test_recorded_frames_give_the_low_resolution_presets(
    make_trajectory: MakeTrajectory, preset: str
) -> None:
    with_poses = make_trajectory("magical/FixColour-TestAll-v0")
    frames = observations(with_poses, PixelSpec((("ego", 1), ("allo", 1)), separate=True))
    assert isinstance(frames, dict)
    recorded = replace(with_poses, frames=frames, bodies=None, score=None)
    assert_same(observations(recorded, preset), observations(with_poses, preset))


@pytest.mark.parametrize(
    "observation", ["raw", "state", PixelSpec(size=64), PixelSpec(samples=1), {"size": 48}]
)
def test_recorded_frames_give_no_other_observation(
    make_frames_trajectory: MakeTrajectory, observation: Any
) -> None:
    recorded = make_frames_trajectory()
    observations(recorded, PixelSpec(samples=4))
    with pytest.raises(TrajectoryError, match=r"recording of|only frames"):
        observations(recorded, observation)


def test_missing_view_is_an_error(
    make_frames_trajectory: MakeTrajectory, make_trajectory: MakeTrajectory
) -> None:
    both = make_frames_trajectory()
    assert both.frames is not None
    ego = make_frames_trajectory(actions=both.actions, frames={"ego": both.frames["ego"]})
    assert_same(observations(ego, "LoRes4E"), observations(both, "LoRes4E"))
    with pytest.raises(TrajectoryError, match="not allo frames"):
        observations(ego, "LoRes3EA")
    with pytest.raises(UnknownNameError, match="expected one of: ego, allo"):
        Frames(make_trajectory(), "egoo")


def test_states_need_velocities(make_trajectory: MakeTrajectory) -> None:
    good = make_trajectory()
    poses = Trajectory.from_bodies(good.env_id, good.scene, good.actions, good.poses)
    assert_same(observations(poses, "LoRes4E"), observations(good, "LoRes4E"))
    with pytest.raises(TrajectoryError, match="expected poses and velocities"):
        observations(poses, "state")
