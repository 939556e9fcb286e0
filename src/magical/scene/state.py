"""The true state of an environment, which scripted experts and privileged learners observe."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magical.scene.poses import Poses
from magical.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class State:
    """A scene, the current poses and velocities of its bodies, and the time left."""

    scene: Scene
    poses: Poses
    velocities: NDArray[np.float64]  # (5 + number of blocks, 3): x, y, angular, per second
    step: int = 0  # control steps since reset
    horizon: int = 0  # control steps in the episode

    @property
    def steps_left(self) -> int:
        """Control steps until the episode ends."""
        return self.horizon - self.step
