"""Carrying: the motion model against the physics, and a block that is carried."""

import math

import numpy as np
import pytest

from magical.experts.carry import carry, motion_table
from magical.experts.geometry import HELD_DISTANCE
from magical.experts.grasp import is_between_fingers
from magical.physics import Simulation
from magical.scene import SHAPES, Block, Colour, Pose, Scene, Shape
from magical.scene.actions import POINTS
from tests.experts.scenes import blocks_at, view_of

CLOSED = 9  # added to an action's id: the same with closed fingers


@pytest.mark.parametrize("shape", SHAPES)
def test_motion_model_agrees_with_the_physics(shape: Shape) -> None:
    """Where a held block is after five steps of one action: within a good half of its size."""
    table = motion_table(0.0, 0.0)
    for action in (1, 2, 3, 4, 8):
        block = Block(shape, Colour.RED, Pose(0.0, HELD_DISTANCE, 0.0))
        simulation = Simulation(Scene(Pose(0.0, 0.0, 0.0), (block,)))
        for each in [CLOSED] * 3 + [action + CLOSED] * 5 + [CLOSED]:
            simulation.step(POINTS[each])
        # Of the motions that begin so and last five steps, the last repeats the action throughout.
        row = np.flatnonzero((table.first == action) & (table.time == 5))[-1]
        predicted = table.block[row, -1]
        assert math.dist(simulation.poses().blocks[0, :2], predicted) < 0.14, action


def test_held_block_is_carried_to_its_goal() -> None:
    scene = blocks_at((0.0, 0.335), (0.1, 0.75), robot=Pose(0.0, 0.0, 0.0))
    simulation, goal = Simulation(scene), (-0.5, 0.1)
    for _ in range(3):
        simulation.step(POINTS[CLOSED])
    for _ in range(25):
        view = view_of(scene, simulation)
        assert is_between_fingers(view, view.blocks[0], is_held=True)
        if math.dist(view.resting_blocks[0], goal) < 0.08:
            break
        simulation.step(POINTS[carry(view, view.blocks[0], goal, 0.08, view.blocks[1:])])
    assert math.dist(simulation.poses().blocks[0, :2], goal) < 0.12
    assert np.allclose(simulation.poses().blocks[1, :2], (0.1, 0.75))
