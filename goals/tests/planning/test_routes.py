"""Routes around blocks."""

import numpy as np
import pytest

from magical_goals.planning.routes import Routes

NOTHING = np.zeros((0, 2))


def routes(*goals, obstacles=NOTHING):
    clearance = np.full(len(obstacles), 0.3)
    return Routes(np.array(goals), np.zeros(len(goals)), obstacles, clearance, 1.0)


def test_without_obstacles_routes_are_straight():
    goal = np.array([0.5, 0.5])
    points = np.random.default_rng(0).uniform(-0.9, 0.3, (50, 2))
    lengths, directions = routes((0.5, 0.5)).at(points)
    straight = np.linalg.norm(goal - points, axis=1)
    np.testing.assert_allclose(lengths, straight, rtol=0.04, atol=0.05)
    assert ((directions * (goal - points)).sum(axis=1) > 0.95 * straight).all()


def test_a_route_leads_around_an_obstacle():
    start = np.array([-0.35, 0.05])
    length, direction = routes((0.5, 0.0), obstacles=np.array([[0.0, 0.0]])).at(start)
    assert 0.9 < length < 1.3
    assert direction[1] > 0.2
    free, _ = routes((0.5, 0.0), obstacles=np.array([[0.0, 0.9]])).at(start)
    assert free == pytest.approx(0.85, abs=0.05)


def test_a_route_leads_to_the_nearest_goal():
    both = routes((0.5, 0.0), (-0.5, 0.0))
    points = np.array([[0.2, 0.3], [-0.2, 0.3]])
    assert both.goals(points).tolist() == [0, 1]


def test_being_at_a_goal_may_cost_so_much_that_another_is_nearer():
    goals = np.array([[0.5, 0.0], [-0.5, 0.0]])
    uneven = Routes(goals, np.array([2.0, 0.0]), NOTHING, np.zeros(0), 1.0)
    assert uneven.goals(np.array([0.4, 0.0])) == 1
    length, _ = uneven.at(np.array([0.0, 0.0]))
    assert length == pytest.approx(0.5, abs=0.05)
