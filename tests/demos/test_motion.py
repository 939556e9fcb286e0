"""Velocities estimated for recorded poses."""

import numpy as np

from magical.demos import Trajectory
from magical.demos.store.reader import TrajectorySource, estimated_states
from tests.demos.conftest import MakeTrajectory


def test_poses_are_kept_and_velocities_are_the_simulations(make_trajectory: MakeTrajectory) -> None:
    trajectory = make_trajectory(steps=40)
    found, true = estimated_states(trajectory), TrajectorySource(trajectory).body_states()
    np.testing.assert_array_equal(found[..., :3], trajectory.poses)
    assert np.abs(found - true)[:, 0, 3:].max() < 0.02
    assert np.median(np.abs(found - true)[:, 0, 3:]) < 1e-6


def test_wrong_predictions_correct_the_velocities(make_trajectory: MakeTrajectory) -> None:
    trajectory = make_trajectory(steps=10)
    poses = np.array(trajectory.poses)
    poses[5:, 0, 0] += 0.01  # the robot jumps
    jumped = Trajectory.from_poses(
        str(trajectory.env_id), trajectory.scene, trajectory.actions, poses
    )
    change = estimated_states(jumped)[5, 0, 3] - estimated_states(trajectory)[5, 0, 3]
    assert abs(change - 8 * 0.01) < 1e-6
