"""Velocities for recorded poses, from a simulation that follows the poses step by step."""

import numpy as np
from numpy.typing import NDArray

from magical.physics import Simulation
from magical.scene import Dynamics, Scene
from magical.scene.constants import CONTROL_RATE

PRECISION = 1e-3  # units or radians: smaller differences may be errors of the recorded poses

Bodies = NDArray[np.float64]  # (5 + blocks, 3), the poses in the rows of `Poses`
States = NDArray[np.float64]  # (..., 5 + blocks, 6), poses and velocities


class PoseFollower:
    """A simulation that is reset to recorded poses after every control step.

    Velocities are the simulation's. If it mispredicts a body, the missing mean velocity is added.
    During contacts, when velocities change within a control step, they are estimates.

    Attributes:
        states: the current poses and velocities, (5 + blocks, 6).
    """

    def __init__(self, scene: Scene, dynamics: Dynamics | None = None) -> None:
        self._simulation = Simulation(scene, dynamics)
        self.states: States = self._simulation.read()

    def predict(self, action: NDArray[np.float64]) -> Bodies:
        """Simulate one control step from the current poses and velocities; returns the poses.

        Args:
            action: drive, turn, grip.
        """
        self._simulation.write(self.states)
        self._predicted = self._simulation.step(action)
        return self._predicted[:, :3].copy()

    def correct(self, bodies: Bodies) -> None:
        """Continue from the poses recorded after the step; bodies that did not move are at rest."""
        still = (bodies == self.states[:, :3]).all(axis=1)
        states = self._predicted.copy()
        lacking = bodies - states[:, :3]
        wrong = np.abs(lacking).max(axis=1) > PRECISION
        states[wrong, 3:] += CONTROL_RATE * lacking[wrong]
        states[still, 3:] = 0.0
        states[:, :3] = bodies
        self.states = states
