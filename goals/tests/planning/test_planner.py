"""Planned control in the simulator, from true states."""

from collections.abc import Sequence

import numpy as np
import pytest

from goals.tests.planning.test_motion import demonstrations
from magical.envs import EnvId
from magical.evaluation import evaluate
from magical.evaluation.policy import Actions, Mask
from magical.scene import NOOP, State
from magical.scene.actions import ACTIONS, Gripper, Longitudinal
from magical.scene.poses import ROBOT
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.planning.motion import Floats, Motion, fit_motion
from magical_goals.planning.planner import HORIZON, PLANS, Planner, Situation, compiled_roll_out

CORNER = np.array([-0.82, 0.82])


@pytest.fixture(scope="module")
def motion() -> Motion:
    return fit_motion(demonstrations("MoveToCorner", (0, 1)))


class Goal:
    """Moves the only block, or the robot, to a place."""

    privileged = True

    def __init__(self, motion: Motion, place: Floats | None = None) -> None:
        self._motion, self._place = motion, place
        self._planners: list[Planner] = []
        self._before: list[Floats | None] = []

    def reset(self, mask: Mask) -> None:
        if mask.all():
            self._planners = [Planner(self._motion) for _ in mask]
            self._before = [None for _ in mask]

    def act(
        self, states: Sequence[State], env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> Actions:
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


def test_a_block_is_brought_to_its_place(motion: Motion) -> None:
    names = ["magical/MoveToCorner-TestJitter-v0", "magical/MoveToCorner-TestDynamics-v0"]
    scores = evaluate(Goal(motion, CORNER), names, rollouts=4, workers=0)
    assert np.mean([row.score for row in scores]) > 0.8


def test_the_robot_drives_to_its_place(motion: Motion) -> None:
    scores = evaluate(Goal(motion), ["magical/MoveToRegion-TestAll-v0"], rollouts=8, workers=0)
    assert [row.score for row in scores] == [1.0] * 8


def situation(pose: tuple[float, float, float], *blocks: tuple[float, float]) -> Situation:
    at = np.array(pose)
    return Situation(at, at, np.array(blocks).reshape(-1, 2), 0, np.array([0.0, 0.9]))


def test_fingers_stay_open_until_the_block_is_between_them(motion: Motion) -> None:
    far = Planner(motion).act(situation((0.0, -0.6, 0.0), (0.0, 0.5)), None)
    assert ACTIONS[far].gripper is Gripper.OPEN
    assert ACTIONS[far].longitudinal is Longitudinal.FORWARD
    near = Planner(motion).act(situation((0.0, -0.6, 0.0), (0.0, -0.29)), None)
    assert ACTIONS[near].gripper is Gripper.CLOSED


def test_a_block_that_was_put_down_is_left_backwards(motion: Motion) -> None:
    away = situation((0.0, 0.0, 0.0), (0.0, -0.7), (0.0, 0.33))
    action = ACTIONS[Planner(motion).act(away, None)]
    assert action.longitudinal is Longitudinal.BACK
    assert action.gripper is Gripper.OPEN


def test_the_robot_is_not_driven_into_another_block(motion: Motion) -> None:
    seen = situation((0.0, -0.6, 0.0), (0.0, 0.6), (0.0, -0.3))
    assert ACTIONS[Planner(motion).act(seen, None)].longitudinal is not Longitudinal.FORWARD


def test_a_robot_that_is_stuck_acts_more_randomly(motion: Motion) -> None:
    seen = situation((0.0, -0.6, 0.0), (0.0, 0.5))
    planner = Planner(motion)
    actions = [planner.act(seen, 0.5) for _ in range(5)]
    assert actions[0] == Planner(motion).act(seen, None)
    assert actions[-1] != actions[0]


def test_a_robot_that_lingers_acts_more_randomly(motion: Motion) -> None:
    turning = [situation((0.0, -0.6, angle), (0.0, 0.5)) for angle in np.linspace(0, 3, 30)]
    planner, differs = Planner(motion), []
    for step, seen in enumerate(turning):
        best = Planner(motion).act(seen._replace(before=turning[max(step - 1, 0)].pose), None)
        action = planner.act(seen._replace(before=turning[max(step - 1, 0)].pose), 0.5)
        differs.append(action != best)
    assert sum(differs[:14]) < sum(differs[15:])


def test_plans_are_rolled_out_step_by_step(motion: Motion) -> None:
    pose, speeds, limit = np.array([0.7, -0.2, 1.0]), np.array([0.02, -0.1]), 0.8
    (kept, backwards, ahead), (kept_spin, turned) = motion.drive[1], motion.turn[1]
    expected = np.empty((HORIZON, len(PLANS.steps), 3))
    for plan, turning in enumerate(PLANS.turning):
        (x, y, angle), (speed, spin) = pose, speeds
        for step, drive in enumerate(PLANS.drives[:, plan]):
            speed = kept * speed + {-1: backwards, 0: 0.0, 1: ahead}[drive]
            spin = kept_spin * spin + turned * PLANS.turns[turning, step]
            new = x - np.sin(angle + spin / 2) * speed, y + np.cos(angle + spin / 2) * speed
            x, y = new if np.abs(new).max() <= limit else (x, y)
            angle += spin
            expected[step, plan] = x, y, angle
    poses = np.empty_like(expected)
    compiled_roll_out(*PLANS[1:], pose, speeds, motion.drive[1], motion.turn[1], limit, poses)
    np.testing.assert_allclose(poses, expected, rtol=1e-9)


def test_plans_of_each_first_action_come_one_after_the_other() -> None:
    first = np.stack([PLANS.turns[PLANS.turning, 0], PLANS.drives[0]], axis=1).reshape(9, -1, 2)
    assert (first == first[:, :1]).all()
    assert len(np.unique(first[:, 0], axis=0)) == 9
