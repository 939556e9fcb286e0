"""A scene made to move."""

import threading

import numpy as np
import pymunk
import pymunk.batch
from numpy.typing import NDArray

from magical.physics.blocks import add_block, add_walls
from magical.physics.robot import COMMANDS, ROBOT_GROUP, Robot
from magical.scene import constants as c
from magical.scene.poses import EYES, ROBOT, Poses
from magical.scene.scene import Dynamics, Scene

_FIELDS = (
    pymunk.batch.BodyFields.POSITION
    | pymunk.batch.BodyFields.ANGLE
    | pymunk.batch.BodyFields.VELOCITY
    | pymunk.batch.BodyFields.ANGULAR_VELOCITY
)
_WIDTH = 6  # floats read for each body: x, y, angle and their velocities


class _Reader(threading.local):
    """One buffer for each thread: pymunk never frees a batch buffer's memory."""

    def __init__(self) -> None:
        self.buffer = pymunk.batch.Buffer()


_reader = _Reader()


class World:
    """The physics of one scene under given dynamics, stepped at the control rate of 8 Hz.

    Bodies are added to the space in drawing order, walls first; the solver's result depends on it.
    """

    def __init__(self, scene: Scene, dynamics: Dynamics | None = None) -> None:
        self.scene = scene
        self.dynamics = dynamics or Dynamics()
        self._space = pymunk.Space()
        self._space.iterations = c.SOLVER_ITERATIONS
        self._space.collision_slop = c.COLLISION_SLOP
        add_walls(self._space)
        if scene.robot_first:
            self._robot = Robot(self._space, scene.robot, self.dynamics)
        blocks = [
            add_block(self._space, block, self.dynamics, group=ROBOT_GROUP + 1 + i)
            for i, block in enumerate(scene.blocks)
        ]
        if not scene.robot_first:
            self._robot = Robot(self._space, scene.robot, self.dynamics)
        bodies = [self._robot.body, *self._robot.fingers, *self._robot.eyes, *blocks]
        self._rows = self._find_rows(bodies)

    def step(self, action: int) -> None:
        """Advance by one control step of 1/8 s under one of the 18 actions."""
        speed, lead, target = COMMANDS[action]
        steer, advance = self._robot.steer, self._space.step
        for _ in range(c.SUBSTEPS):
            steer(speed, lead, target)
            advance(c.SUBSTEP_TIME)

    def poses(self) -> Poses:
        """Where every body is now."""
        return Poses(self.read()[:, :3].copy())

    def velocities(self) -> NDArray[np.float64]:
        """Velocity (x, y, angular) of every body in the rows of `Poses`, (5 + blocks, 3)."""
        return self.read()[:, 3:].copy()

    def read(self) -> NDArray[np.float64]:
        """Pose and velocity of every body in one pass: x, y, angle, their velocities.

        Returns (5 + number of blocks, 6) in the rows of `Poses`. Eyes have no place of their own;
        theirs is the robot's.
        """
        table = self._read_all()[self._rows]
        table[EYES, :2] = table[ROBOT, :2]
        table[EYES, 3:5] = table[ROBOT, 3:5]
        return table

    def _read_all(self) -> NDArray[np.float64]:
        buffer = _reader.buffer
        buffer.clear()
        pymunk.batch.get_space_bodies(self._space, _FIELDS, buffer)
        return np.frombuffer(buffer.float_buf(), dtype=np.float64).reshape(-1, _WIDTH)

    def _find_rows(self, bodies: list[pymunk.Body]) -> NDArray[np.intp]:
        buffer = _reader.buffer
        buffer.clear()
        pymunk.batch.get_space_bodies(self._space, pymunk.batch.BodyFields.BODY_ID, buffer)
        ids = np.frombuffer(buffer.int_buf(), dtype=np.uintp).tolist()
        return np.array([ids.index(body.id) for body in bodies])
