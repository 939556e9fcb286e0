"""Scenes and states that the tests of experts share."""

import numpy as np

from magical.experts import StateView
from magical.physics import Simulation
from magical.scene import Block, Colour, Point, Pose, Poses, Scene, Shape, State

CORNER = Pose(0.8, 0.8, 0.0)


def state_of(simulation: Simulation, scene: Scene, step: int = 0, horizon: int = 100) -> State:
    """The simulation's present state."""
    table = simulation.read()
    return State(scene, Poses(table[:, :3]), table[:, 3:], step, horizon)


def view_of(scene: Scene, simulation: Simulation | None = None) -> StateView:
    """What experts see of the present state, or of the scene at rest."""
    return StateView.from_state(state_of(simulation or Simulation(scene), scene))


def blocks_at(*places: Point, robot: Pose = CORNER) -> Scene:
    """Red circles."""
    blocks = tuple(Block(Shape.CIRCLE, Colour.RED, Pose(x, y, 0.0)) for x, y in places)
    return Scene(robot, blocks)


def scattered(scene: Scene, rng: np.random.Generator) -> State:
    """The scene's bodies anywhere, at any angle and velocity."""
    poses = Poses.at_rest(scene).bodies.copy()
    poses[:, :2] = rng.uniform(-0.88, 0.88, size=(len(poses), 2))
    poses[:, 2] = rng.uniform(-20, 20, size=len(poses))
    return State(scene, Poses(poses), rng.normal(size=poses.shape), 0, 100)
