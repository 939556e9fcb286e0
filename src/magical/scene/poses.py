"""The poses of all bodies at one time step, and the state of an episode."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magical.scene.constants import FINGER_OPEN, FINGER_ROOT_X, FINGER_ROOT_Y, SIDES
from magical.scene.geometry import to_workspace
from magical.scene.scene import Pose, Scene

ROBOT = 0  # row of the robot's body
FINGERS = slice(1, 3)  # rows of the fingers, left and right
EYES = slice(3, 5)  # rows of the eyes, left and right; x and y are the robot's
FIRST_BLOCK = 5  # row of the scene's first block


@dataclass(frozen=True, slots=True)
class Poses:
    """The pose (x, y, angle) of every body, in the rows named above.

    A finger's position is that of its root; its angle is that of its own frame in the workspace
    (an open left finger is at the robot's angle + pi/8). An eye's angle turns its pupil.
    """

    bodies: NDArray[np.float64]  # (5 + number of blocks, 3)

    @property
    def robot(self) -> Pose:
        """The robot's pose."""
        return Pose(*self.bodies[ROBOT].tolist())

    @property
    def blocks(self) -> NDArray[np.float64]:
        """The blocks' poses in the scene's order, (number of blocks, 3)."""
        return self.bodies[FIRST_BLOCK:]

    @property
    def finger_angles(self) -> NDArray[np.float64]:
        """The fingers' angles in the workspace, left and right, (2,) radians."""
        return self.bodies[FINGERS, 2]

    @staticmethod
    def at_rest(scene: Scene) -> "Poses":
        """A scene's initial poses: fingers fully open, eyes straight ahead."""
        x, y, angle = scene.robot
        roots = [to_workspace((side * FINGER_ROOT_X, FINGER_ROOT_Y), scene.robot) for side in SIDES]
        rows = [
            (x, y, angle),
            *((*root, angle - side * FINGER_OPEN) for root, side in zip(roots, SIDES, strict=True)),
            *((x, y, angle) for _ in SIDES),
            *(block.pose for block in scene.blocks),
        ]
        return Poses(np.array(rows, dtype=np.float64))


@dataclass(frozen=True, slots=True)
class State:
    """The true state of an environment: a scene, its bodies' motion, and the time left.

    Scripted experts and privileged learners observe it.
    """

    scene: Scene
    poses: Poses
    velocities: NDArray[np.float64]  # (5 + number of blocks, 3): x, y, angular, per second
    step: int  # control steps since reset
    horizon: int  # control steps in the episode

    @property
    def bodies(self) -> NDArray[np.float64]:
        """Poses and velocities, (5 + number of blocks, 6)."""
        return np.hstack([self.poses.bodies, self.velocities])
