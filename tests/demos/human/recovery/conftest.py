"""Recordings as the published files hold them, of episodes whose poses are known."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.demos import Trajectory
from magical.demos.generate import demonstrate
from magical.demos.human.published import PublishedDemonstration, pack
from magical.render import Renderer
from magical.scene import Scene, View

Record = Callable[..., PublishedDemonstration]


def render(scene: Scene, bodies: NDArray[np.float64]) -> dict[View, NDArray[np.uint8]]:
    """Both frames of one time step, as in the published files."""
    frames = {}
    for view in View:
        frames[view] = np.empty((384, 384, 3), np.uint8)
        Renderer(scene, view, 384, 1, whole_dashes=False).render(bodies, frames[view])
    return frames


@pytest.fixture(scope="session")
def record() -> Record:
    """Renders the first time steps of a trajectory."""

    def make(trajectory: Trajectory, steps: int) -> PublishedDemonstration:
        assert trajectory.poses is not None
        frames = [render(trajectory.scene, bodies) for bodies in trajectory.poses[: steps + 1]]
        return PublishedDemonstration(
            env_id=trajectory.env_id,
            actions=trajectory.actions[:steps].astype(np.int64),
            score=1.0,
            source={"source": "demo.pkl.gz", "source_sha256": "0" * 64},
            packed={view: [pack(pair[view]) for pair in frames] for view in View},
        )

    return make


@pytest.fixture(scope="session")
def pushing() -> Trajectory:
    """An expert that pushes a block."""
    return demonstrate("magical/MoveToCorner-Demo-v0", seed=0)
