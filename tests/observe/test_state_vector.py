"""The state vector has the documented layout."""

import math

import numpy as np
import pytest

from magical.errors import InvalidSceneError
from magical.observe import StateSpec
from magical.physics import Simulation
from magical.scene import POINTS, Block, Colour, Pose, Region, Scene, Shape

SCENE = Scene(
    Pose(0.1, 0.2, 0.3),
    (Block(Shape.STAR, Colour.BLUE, Pose(0.5, -0.5, -1.0)),),
    (Region(Colour.YELLOW, -0.9, 0.8, 0.4, 0.3),),
)
SPEC = StateSpec(max_blocks=2, max_regions=1)


def _named(vector: np.ndarray) -> dict[str, float]:
    return dict(zip(SPEC.names, vector.tolist(), strict=True))


def test_layout_and_bounds_in_the_given_array() -> None:
    out = np.full(SPEC.size, 7, np.float32)
    observer = SPEC.observer(out)
    observer.start(SCENE, Simulation(SCENE).read())
    expected = {
        "robot.x": 0.1, "robot.y": 0.2, "robot.cos": math.cos(0.3), "robot.sin": math.sin(0.3),
        "robot.left_angle": math.pi / 8, "robot.right_angle": -math.pi / 8,
        "block0.present": 1, "block0.star": 1, "block0.blue": 1, "block0.x": 0.5, "block0.y": -0.5,
        "block0.cos": math.cos(-1.0), "block0.sin": math.sin(-1.0),
        "region0.present": 1, "region0.yellow": 1, "region0.left": -0.9, "region0.top": 0.8,
        "region0.height": 0.4, "region0.width": 0.3,
    }  # fmt: skip
    for name, value in _named(out).items():
        assert value == pytest.approx(expected.get(name, 0.0), abs=1e-6), name
    assert out in SPEC.space
    for name, low, high in zip(SPEC.names, SPEC.space.low, SPEC.space.high, strict=True):
        assert np.isfinite([low, high]).all() == ("velocity" not in name), name


def test_velocities_and_finger_motion() -> None:
    simulation, observer = Simulation(SCENE), SPEC.observer()
    observer.start(SCENE, simulation.read())
    bodies = simulation.step(POINTS[13])  # forward-left-closed
    observer.update(bodies)
    entries = _named(observer.out)
    assert entries["robot.velocity_x"] == pytest.approx(bodies[0, 3], abs=1e-6)
    assert entries["robot.angular_velocity"] == pytest.approx(bodies[0, 5], abs=1e-6)
    assert entries["robot.left_angle"] == pytest.approx(bodies[1, 2] - bodies[0, 2], abs=1e-6)
    assert entries["robot.right_velocity"] == pytest.approx(bodies[2, 5] - bodies[0, 5], abs=1e-6)
    assert entries["robot.left_angle"] < math.pi / 8


def test_too_many_blocks() -> None:
    crowded = Scene(SCENE.robot, SCENE.blocks * 3)
    with pytest.raises(InvalidSceneError, match="at most 2 blocks"):
        SPEC.observer().start(crowded, Simulation(crowded).read())
