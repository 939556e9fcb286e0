"""The fingers' initial positions: the pin joints' first direction is the published one."""

import json
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from magical.physics import Simulation, finger_position
from magical.scene import POINTS, ROBOT, Pose, Poses, Scene, rotate, to_workspace
from magical.scene import constants as c
from magical.tasks import TASKS

# Robot pose and finger angles after the first step from each Demo scene, for each action. Written
# under pymunk 5.6.0 by studies/determinism (commit eb101564); in that version this package's
# physics is within the rounding of all recorded motions.
FIRST_STEPS = json.loads((Path(__file__).parent / "first-steps.json").read_text())
POSES = [Pose(*row) for row in np.random.default_rng(0).uniform(-0.8, 0.8, (200, 3)).tolist()]
POSES += [Pose(0, 0, 0), Pose(-0.7, 0, -math.pi / 2), Pose(0.5, 0.25, 3)]
ROOTS = [(side * c.FINGER_ROOT_X, c.FINGER_ROOT_Y) for side in c.SIDES]


def displacement(root: tuple[float, float], pose: Pose) -> list[Fraction]:
    """By how much a finger is off its root in the workspace, exactly."""
    simulation = Simulation(Scene(pose))
    body = simulation._bodies[ROBOT]
    pairs = zip(finger_position(body, root, pose), to_workspace(root, pose), strict=True)
    return [Fraction(position) - Fraction(anchor) for position, anchor in pairs]


@pytest.mark.parametrize("root", ROOTS)
def test_fingers_are_displaced_by_the_least_power_of_two_of_the_rounding_error(
    root: tuple[float, float],
) -> None:
    for pose in POSES:
        anchor = to_workspace(root, pose)
        parts = zip(anchor, pose[:2], rotate(root, pose.angle), strict=True)
        error = [Fraction(total) - (Fraction(a) + Fraction(b)) for total, a, b in parts]
        moved = displacement(root, pose)
        if not any(error):
            assert not any(moved)
            continue
        factor = max(moved, key=abs) / max(error, key=abs)
        assert moved == [factor * each for each in error]
        assert factor in {1, 2, 4, 8, 16, 32, 64}
        at_half = [Fraction(a) + factor / 2 * e for a, e in zip(anchor, error, strict=True)]
        assert factor == 1 or any(Fraction(float(each)) != each for each in at_half)


def test_a_coordinate_next_to_zero_does_not_displace_fingers_far() -> None:
    for root in ROOTS:
        assert math.hypot(*map(float, displacement(root, Pose(1e-9, 0.3, 0.1)))) < 1e-12


@pytest.mark.parametrize("name", FIRST_STEPS)
def test_the_first_step_from_a_demo_scene(name: str) -> None:
    for action, point in enumerate(POINTS):
        simulation = Simulation(TASKS[name].demo)
        start, poses = simulation.read(), Poses(simulation.step(point)[:, :3])
        found = [*poses.robot, *poses.finger_angles]
        assert np.allclose(found, FIRST_STEPS[name][action], rtol=0, atol=1e-8), action
        assert action != 0 or np.array_equal(simulation.read(), start)  # at rest
