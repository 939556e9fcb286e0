"""Demonstrations as the states between which their demonstrator moved one thing."""

import numpy as np

from magical.demos.store.trajectory import Trajectory
from magical.errors import DemonstrationsError
from magical.learning.intent.demonstrator import Episode
from magical.learning.objects.hindsight import find_carries
from magical.scene import Poses
from magical.scene.poses import FIRST_BLOCK, ROBOT


def make_episode(trajectory: Trajectory, rng: np.random.Generator) -> Episode:
    """A demonstration by the states after its carries; without any, by where the robot went.

    Args:
        trajectory: with poses.
        rng: samples the moves that were not made.

    Raises:
        DemonstrationsError: it has no poses.
    """
    poses = trajectory.poses
    if poses is None:
        raise DemonstrationsError(
            f"{trajectory.env_id}: expected demonstrations with poses, found frames alone; "
            "`magical demos import` recovers the poses of the published ones"
        )
    intended = trajectory.is_demonstrated & (trajectory.labels == trajectory.actions)
    places = poses[:, FIRST_BLOCK:, :2]
    carries = find_carries(poses[:, ROBOT], places, intended) if places.shape[1] else []
    ends = [last + 1 for _, _, last in carries] or [len(trajectory)]
    return Episode(trajectory.scene, [Poses(poses[t]) for t in (0, *ends)], rng)
