"""Routes around blocks."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from magical_goals.planning.routes import SIDE, Routes

NOTHING = np.zeros((0, 2))


def routes(*goals: tuple[float, float], obstacles: np.ndarray = NOTHING) -> Routes:
    clearance = np.full(len(obstacles), 0.3)
    return Routes(np.array(goals), np.zeros(len(goals)), obstacles, clearance, 1.0)


def test_without_obstacles_routes_are_straight() -> None:
    goal = np.array([0.5, 0.5])
    points = np.random.default_rng(0).uniform(-0.9, 0.3, (50, 2))
    lengths, directions = routes((0.5, 0.5)).at(points)
    straight = np.linalg.norm(goal - points, axis=1)
    np.testing.assert_allclose(lengths, straight, rtol=0.04, atol=0.05)
    assert ((directions * (goal - points)).sum(axis=1) > 0.95 * straight).all()


def test_a_route_leads_around_an_obstacle() -> None:
    start = np.array([-0.35, 0.05])
    length, direction = routes((0.5, 0.0), obstacles=np.array([[0.0, 0.0]])).at(start)
    assert 0.9 < length < 1.3
    assert direction[1] > 0.2
    free, _ = routes((0.5, 0.0), obstacles=np.array([[0.0, 0.9]])).at(start)
    assert free == pytest.approx(0.85, abs=0.05)


def test_a_route_leads_to_the_nearest_goal() -> None:
    both = routes((0.5, 0.0), (-0.5, 0.0))
    points = np.array([[0.2, 0.3], [-0.2, 0.3]])
    assert both.goals(points).tolist() == [0, 1]


def test_being_at_a_goal_may_cost_so_much_that_another_is_nearer() -> None:
    goals = np.array([[0.5, 0.0], [-0.5, 0.0]])
    uneven = Routes(goals, np.array([2.0, 0.0]), NOTHING, np.zeros(0), 1.0)
    assert uneven.goals(np.array([0.4, 0.0])) == 1
    length, _ = uneven.at(np.array([0.0, 0.0]))
    assert length == pytest.approx(0.5, abs=0.05)


def test_routes_stay_within_the_limit() -> None:
    wall = np.array([[x, 0.0] for x in np.linspace(-0.4, 1.0, 8)])
    goal, start = np.array([[0.5, 0.5]]), np.array([0.5, -0.5])
    wide = Routes(goal, np.zeros(1), wall, np.full(8, 0.25), 1.0).at(start)[0]
    narrow = Routes(goal, np.zeros(1), wall, np.full(8, 0.25), 0.5).at(start)[0]
    assert narrow > wide + 0.5


def test_of_goals_at_the_same_point_the_cheaper_counts() -> None:
    goals = np.array([[0.5, 0.0], [0.501, 0.0]])
    for costs, cheaper in (([2.0, 0.0], 1), ([0.0, 2.0], 0)):
        found = Routes(goals, np.array(costs), NOTHING, np.zeros(0), 1.0)
        assert found.goals(np.array([0.2, 0.0])) == cheaper
        assert found.at(np.array([0.2, 0.0]))[0] == pytest.approx(0.3, abs=0.05)


def test_lengths_are_interpolated_between_the_points_of_a_grid() -> None:
    found = routes((0.5, 0.0), obstacles=np.array([[0.0, 0.0]]))
    ticks = np.linspace(-1.0, 1.0, SIDE)
    grid = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    interpolated = RegularGridInterpolator((ticks, ticks), found.at(grid)[0])
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (4, 50, 2))
    lengths, directions = found.at(points)
    np.testing.assert_allclose(lengths, interpolated(points), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
