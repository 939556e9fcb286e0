"""Planned control in the simulator, from true states."""

import numpy as np
import pytest

from goals.tests.planning.test_motion import demonstrations
from magical.evaluation import evaluate
from magical.scene import NOOP
from magical.scene.actions import ACTIONS, Gripper, Longitudinal
from magical.scene.poses import ROBOT
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.planning.motion import fit_motion
from magical_goals.planning.planner import Planner, Situation

CORNER = np.array([-0.82, 0.82])


@pytest.fixture(scope="module")
def motion():
    return fit_motion(demonstrations("MoveToCorner", (0, 1)))


class Goal:
    """Moves the only block, or the robot, to a place."""

    privileged = True

    def __init__(self, motion, place=None):
        self._motion, self._place = motion, place
        self._planners = []
        self._before = []

    def reset(self, mask):
        if mask.all():
            self._planners = [Planner(self._motion) for _ in mask]
            self._before = [None for _ in mask]

    def act(self, states, env_ids, rng):
        actions = []
        for row, (state, uniform) in enumerate(zip(states, rng.random(len(states)), strict=True)):
            pose, blocks = state.poses.bodies[ROBOT], state.poses.blocks[:, :2]
            before = self._before[row]
            self._before[row] = pose
            target = ROBOT_TARGET if self._place is None else 0
            place = self._place
            if place is None:
                place = np.array(state.scene.regions[0].centre)
            elif np.linalg.norm(blocks[0] - place) < 0.05:
                actions.append(NOOP)
                continue
            seen = Situation(pose, pose if before is None else before, blocks, target, place)
            actions.append(self._planners[row].act(seen, uniform))
        return np.array(actions)


def test_a_block_is_brought_to_its_place(motion):
    names = ["magical/MoveToCorner-TestJitter-v0", "magical/MoveToCorner-TestDynamics-v0"]
    scores = evaluate(Goal(motion, CORNER), names, rollouts=4, workers=0)
    assert np.mean([row.score for row in scores]) > 0.8


def test_the_robot_drives_to_its_place(motion):
    scores = evaluate(Goal(motion), ["magical/MoveToRegion-TestAll-v0"], rollouts=8, workers=0)
    assert [row.score for row in scores] == [1.0] * 8


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
