"""Planned control, from true states."""

import numpy as np
import pytest

from goals.tests.planning.test_motion import demonstrations
from magical.scene import ACTIONS, Gripper, Longitudinal
from magical_goals.planning.motion import fit_motion
from magical_goals.planning.planner import Planner, Situation


@pytest.fixture(scope="module")
def motion():
    return fit_motion(demonstrations("MoveToCorner", (0, 1)))


def situation(pose, *blocks):
    at = np.array(pose)
    return Situation(at, at, np.array(blocks).reshape(-1, 2), 0, np.array([0.0, 0.9]))


def test_fingers_stay_open_until_the_block_is_between_them(motion):
    far = Planner(motion).act(situation((0.0, -0.6, 0.0), (0.0, 0.5)), None)
    assert ACTIONS[far].gripper is Gripper.OPEN
    assert ACTIONS[far].longitudinal is Longitudinal.FORWARD
    near = Planner(motion).act(situation((0.0, -0.6, 0.0), (0.0, -0.29)), None)
    assert ACTIONS[near].gripper is Gripper.CLOSED


def test_a_block_that_was_put_down_is_left_backwards(motion):
    away = situation((0.0, 0.0, 0.0), (0.0, -0.7), (0.0, 0.33))
    action = ACTIONS[Planner(motion).act(away, None)]
    assert action.longitudinal is Longitudinal.BACK
    assert action.gripper is Gripper.OPEN


def test_the_robot_is_not_driven_into_another_block(motion):
    seen = situation((0.0, -0.6, 0.0), (0.0, 0.6), (0.0, -0.3))
    assert ACTIONS[Planner(motion).act(seen, None)].longitudinal is not Longitudinal.FORWARD


def test_a_robot_that_is_stuck_acts_more_randomly(motion):
    seen = situation((0.0, -0.6, 0.0), (0.0, 0.5))
    planner = Planner(motion)
    actions = [planner.act(seen, 0.5) for _ in range(5)]
    assert actions[0] == Planner(motion).act(seen, None)
    assert actions[-1] != actions[0]
