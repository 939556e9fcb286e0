"""The simulation: construction, dynamics, limits."""

import numpy as np
import pytest
from pymunk._chipmunk_cffi import lib

from magical.physics import Simulation
from magical.scene import FINGERS, POINTS, Block, Colour, Dynamics, Pose, Poses, Scene, Shape

SCENE = Scene(
    Pose(0.3, -0.2, 0.7),
    (
        Block(Shape.SQUARE, Colour.RED, Pose(0.0, 0.3, 0.1)),
        Block(Shape.CIRCLE, Colour.BLUE, Pose(-0.5, 0.5, 1.0)),
        Block(Shape.PENTAGON, Colour.GREEN, Pose(0.6, 0.6, -2.0)),
        Block(Shape.STAR, Colour.YELLOW, Pose(-0.6, -0.6, 3.0)),
    ),
)


@pytest.mark.parametrize("robot_first", [False, True])
def test_initial_poses_are_the_scenes_and_finger_moments_the_published(robot_first: bool) -> None:
    scene = Scene(SCENE.robot, SCENE.blocks, robot_first=robot_first)
    simulation = Simulation(scene)
    found, expected = simulation.read()[:, :3], Poses.at_rest(scene).bodies
    off_root = found[FINGERS, :2] - expected[FINGERS, :2]
    assert 0 < np.abs(off_root).max() < 1e-14  # on purpose: `finger_position`
    found[FINGERS, :2] = expected[FINGERS, :2]
    assert np.array_equal(found, expected)
    assert not simulation.read()[:, 3:].any()
    moments = [lib.cpBodyGetMoment(finger) for finger in simulation._bodies[FINGERS]]
    assert moments == pytest.approx([0.005006, 0.004983], abs=5e-7)


@pytest.mark.parametrize("field", Dynamics().to_dict())
def test_every_dynamics_parameter_matters(field: str) -> None:
    # The robot drives at a block off its centre, turning and gripping.
    scene = Scene(Pose(0, 0, 0), (Block(Shape.SQUARE, Colour.RED, Pose(0.08, 0.4, 0.3)),))
    actions = [(1.0, 1.0, 1.0)] * 8
    tables: list[np.ndarray] = []
    for dynamics in (Dynamics(), Dynamics(**{field: 0.5 * getattr(Dynamics(), field)})):
        simulation = Simulation(scene, dynamics)
        for action in actions:
            simulation.step(action)
        tables.append(simulation.read())
    assert not np.allclose(tables[0], tables[1], atol=1e-6)


def test_the_strongest_and_weakest_forces_and_the_furthest_poses_stay_finite() -> None:
    blocks = tuple(Block(b.shape, b.colour, Pose(-1e3, 1e3, 1e3)) for b in SCENE.blocks)
    for scene in (SCENE, Scene(Pose(1e3, 1e3, 1e3), blocks)):
        for force in (5e-324, 1e308):
            simulation = Simulation(scene, Dynamics(*[force] * 5))
            for point in POINTS:
                simulation.step(point)
            assert np.isfinite(simulation.read()).all()


@pytest.mark.linux
def test_simulations_free_their_memory() -> None:
    import resource  # only there

    for _ in range(50):
        Simulation(SCENE).step(POINTS[0])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(500):
        Simulation(SCENE).step(POINTS[0])
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 5000  # kB
