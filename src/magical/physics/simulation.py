"""The physics of one episode."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pymunk
from numpy.typing import NDArray

from magical.errors import InvalidSceneError
from magical.physics.blocks import add_block, add_walls
from magical.physics.chipmunk import address, c_functions
from magical.physics.robot import COMMANDS, ROBOT_GROUP, Robot, command
from magical.scene import constants as c
from magical.scene.actions import AnyAction
from magical.scene.poses import Poses
from magical.scene.scene import Dynamics, Scene


class Simulation:
    """A scene under given dynamics, stepped at the control rate of 8 Hz.

    Bodies are added to the space in rendering order, walls first: the solver's result depends on
    the order (docs/specification.md, section 6).
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
        self._turn_limit = c.TURN_MAX_BIAS
        self._bodies = [self._robot.body, *self._robot.fingers, *self._robot.eyes, *blocks]
        # For each row of `Poses`, the body that holds its position and the one with its angle.
        places = [self._robot.body if b in self._robot.eyes else b for b in self._bodies]
        self._places = list(zip(places, self._bodies, strict=True))
        self._compiled = compiled()
        if self._compiled:
            robot = self._robot
            drive = self._space, robot.body, robot.control, *robot.fingers, *robot.motors
            self._drive = [address(part) for part in drive]
            self._addresses = np.array([list(map(address, pair)) for pair in self._places])

    def step(self, action: AnyAction) -> None:
        """Advance by one control step of 1/8 s.

        Args:
            action: index into `scene.ACTIONS`, or drive, turn and grip; not checked here.
        """
        motion, turn_limit = COMMANDS[action] if isinstance(action, int) else command(action)
        if turn_limit != self._turn_limit:
            self._robot.gear.max_bias = self._turn_limit = turn_limit
        if self._compiled:
            self._compiled[0](*self._drive, *motion)
            return
        for _ in range(c.SUBSTEPS):
            self._robot.steer(*motion)
            self._space.step(c.SUBSTEP_TIME)

    def poses(self) -> Poses:
        """The current pose of every body."""
        return Poses(self.read()[:, :3].copy())

    def read(self) -> NDArray[np.float64]:
        """Pose and velocity of every body in one pass.

        Returns:
            A new array (5 + number of blocks, 6) in the rows of `Poses`: x, y, angle and their
            velocities, in units, radians and seconds. Eyes have no position of their own; theirs
            is the robot's.
        """
        if self._compiled:
            found = np.empty((len(self._addresses), 6))
            self._compiled[1](self._addresses, found)
            return found
        return np.array(
            [[*p.position, a.angle, *p.velocity, a.angular_velocity] for p, a in self._places]
        )

    def write(self, bodies: NDArray[np.float64]) -> None:
        """Move every body to a pose and give it a velocity: the inverse of `read`.

        Contacts from the previous step are dropped only if the bodies have moved apart.

        Args:
            bodies: (5 + number of blocks, 6), as `read` returns it; the eyes' positions have
                no effect.

        Raises `InvalidSceneError` for a value that is not finite or beyond `MAX_COORDINATE`.
        """
        furthest = np.abs(bodies).max()
        if not furthest <= c.MAX_COORDINATE:  # also true for NaN
            raise InvalidSceneError(
                f"poses: expected finite numbers up to {c.MAX_COORDINATE:g}, found {furthest:g}"
            )
        for body, row in zip(self._bodies, bodies.tolist(), strict=True):
            x, y, angle, velocity_x, velocity_y, spin = row
            body.position, body.angle = (x, y), angle
            body.velocity, body.angular_velocity = (velocity_x, velocity_y), spin


@cache
def compiled() -> tuple[Callable[..., None], Callable[..., None]] | None:
    """Compiled `substeps` and `read` (module `substeps`); None if `c_functions` returns None."""
    if (functions := c_functions()) is None:
        return None
    from magical.physics.substeps import compiled_substeps, read  # imports numba

    return compiled_substeps(functions), read
