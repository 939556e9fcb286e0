"""What every task's expert does with a move: paths, grasps, carrying, and the robot's frame."""

import math

import numpy as np
import pytest

from magical.experts.carry import carry, motion_table
from magical.experts.geometry import (
    HELD_DISTANCE,
    bearing,
    project_on_segments,
    segment_distance,
    wrap_angle,
)
from magical.experts.grasp import (
    SIDE_SWITCH_STEPS,
    SIDES,
    best_side,
    gate_point,
    grasp_costs,
    is_between_fingers,
)
from magical.experts.paths import is_clear, next_waypoint
from magical.physics import Simulation
from magical.scene import POINTS, SHAPES, Block, Colour, Pose, Scene, Shape
from tests.experts.scenes import blocks_at, view_of

CLOSED = 9  # added to an action's id: the same with closed fingers
NO_PREFERENCES = [0.0] * len(SIDES)


def test_bearing_is_the_angle_that_faces_a_point() -> None:
    view = view_of(Scene(Pose(0.1, -0.2, bearing((0.1, -0.2), (0.6, 0.4)))))
    x, y = view.to_robot_frame((0.6, 0.4))
    assert x == pytest.approx(0.0, abs=1e-12)
    assert y == pytest.approx(math.hypot(0.5, 0.6))
    assert view.point_ahead(y) == pytest.approx((0.6, 0.4))
    assert wrap_angle(3 * math.pi / 2) == pytest.approx(-math.pi / 2)


def test_projection_on_arrays_agrees_with_single_points() -> None:
    rng = np.random.default_rng(0)
    starts, ends, points = rng.uniform(-1, 1, size=(3, 50, 2))
    ends[0] = starts[0]
    shares, distances = project_on_segments(starts, ends, points)
    slow = [
        segment_distance(start, end, point)
        for start, end, point in zip(starts, ends, points, strict=True)
    ]
    np.testing.assert_allclose(distances, slow, atol=1e-12)
    nearest = starts + shares[:, None] * (ends - starts)
    np.testing.assert_allclose(np.linalg.norm(points - nearest, axis=1), slow, atol=1e-12)


def test_path_is_straight_or_leads_around_obstacles() -> None:
    assert next_waypoint((-0.5, 0.0), (0.5, 0.0), [(0.0, 0.6)], 0.34, 0.0) == (0.5, 0.0)
    at, goal, wall = (-0.6, 0.0), (0.6, 0.0), [(0.0, y) for y in (0.0, 0.2, 0.4)]
    least, length = math.inf, 0.0
    for _ in range(60):
        point = next_waypoint(at, goal, wall, 0.3, 0.0)
        step = min(0.05, math.dist(at, point))
        angle = math.atan2(point[1] - at[1], point[0] - at[0])
        at = (at[0] + step * math.cos(angle), at[1] + step * math.sin(angle))
        least = min(least, *(math.dist(at, obstacle) for obstacle in wall))
        length += step
    assert math.dist(at, goal) < 0.06
    assert least > 0.22
    assert length < 2.2


def test_clear_counts_only_what_comes_closer() -> None:
    assert is_clear((0.0, 0.0), (1.0, 0.0), [(-0.1, 0.0)], 0.3)
    assert not is_clear((0.0, 0.0), (1.0, 0.0), [(0.2, 0.1)], 0.3)


def test_grasp_costs_rise_with_obstacles_on_the_way_and_walls_behind_it() -> None:
    view, goal = view_of(blocks_at((0.0, 0.0))), (0.5, 0.5)
    free = grasp_costs(view, (0.0, 0.0), goal, [], SIDES)
    for side, other in ((0.0, (0.0, -0.3)), (math.pi / 2, (0.3, 0.0)), (0.0, (0.18, 0.0))):
        costs = grasp_costs(view, (0.0, 0.0), goal, [other], SIDES)
        nearest = np.abs(wrap_angle(SIDES - side)).argmin()
        assert (costs >= free).all()
        assert costs[nearest] > free[nearest] + 10.0
    side, _ = best_side(view_of(blocks_at((-0.88, 0.0))), (-0.88, 0.0), goal, [], NO_PREFERENCES)
    assert math.sin(side) > 0.3  # facing left
    assert max(map(abs, gate_point((0.0, -0.3), 0.0))) < 0.8


def test_a_side_is_left_only_for_a_clearly_better_one() -> None:
    view = view_of(blocks_at((0.0, 0.0)))
    block, goal = view.blocks[0], (-0.6, -0.3)
    best, least = best_side(view, block, goal, (), NO_PREFERENCES)
    costs = grasp_costs(view, block, goal, (), SIDES)
    near = SIDES[(costs > least) & (costs < least + SIDE_SWITCH_STEPS)]
    far = SIDES[costs > least + SIDE_SWITCH_STEPS]
    assert len(near)
    assert len(far)
    for side in near:
        kept, cost = best_side(view, block, goal, (), NO_PREFERENCES, current=side)
        assert kept == side
        assert cost > least
    for side in far:
        assert best_side(view, block, goal, (), NO_PREFERENCES, current=side)[0] == best


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
