"""The robot's motion as demonstrations show it."""

from dataclasses import replace

import numpy as np
import pytest

from magical.demos.generate import demonstrate
from magical.scene import Action, Longitudinal, to_continuous
from magical.scene.constants import BLOCK_SIZE, ROBOT_RADIUS
from magical_goals.objects.data import ParsedDemonstration, parse_demonstrations
from magical_goals.objects.parser import ParsedFrames, parse_frames
from magical_goals.planning.motion import (
    PRIOR,
    fit_motion,
    robot_steps,
)


def demonstrations(task, seeds, perturb=0.0):
    shown = [demonstrate(f"magical/{task}-Demo-v0", seed=s, perturb=perturb) for s in seeds]
    return parse_demonstrations(tuple((task, each) for each in shown), parse_frames)


@pytest.fixture(scope="module")
def corner():
    return demonstrations("MoveToCorner", (0, 1))


def test_free_motion_of_another_demonstration_is_predicted(corner):
    motion = fit_motion(corner)
    ((_, trajectory, parsed),) = demonstrations("MoveToRegion", (2,))
    steps = robot_steps(parsed.robot[:-1], parsed.robot[1:])
    commands = to_continuous(trajectory.actions)[1:]
    kept, back, ahead = motion.drive[0]
    drive = kept * steps[:-1, 0] + np.array([back, 0.0, ahead])[commands[:, 0].astype(int) + 1]
    turn = motion.turn[0] @ [steps[:-1, 1], commands[:, 1]]
    errors = np.abs(steps[1:] - np.stack([drive, turn], axis=1))
    assert (np.median(errors, axis=0) < (0.005, 0.03)).all()


def test_a_block_slows_the_robot_down(corner):
    free, held = fit_motion(corner).speeds
    assert (held[1:] < free[1:]).all()


def test_blocks_are_grasped_where_they_touch_the_robot(corner):
    aside, nearest, farthest = fit_motion(corner).grasp
    assert aside < BLOCK_SIZE
    assert ROBOT_RADIUS < nearest <= farthest < ROBOT_RADIUS + 2 * BLOCK_SIZE


def test_what_was_never_demonstrated_is_as_in_other_tasks():
    motion = fit_motion(demonstrations("MoveToRegion", (0, 1)))
    for shown, prior in ((motion.drive, PRIOR.drive), (motion.turn, PRIOR.turn)):
        np.testing.assert_allclose(shown[1], prior[1])  # without blocks
        assert (shown[0] != prior[0]).all()


def test_steps_against_a_wall_teach_nothing(corner):
    task, trajectory, parsed = corner[0]
    recorded = (*parsed, trajectory.bodies)
    still = [np.concatenate([each, np.repeat(each[-1:], 60, axis=0)]) for each in recorded]
    ahead = np.append(trajectory.actions, np.full(60, Action(Longitudinal.FORWARD).id))
    driven = replace(trajectory, actions=ahead, bodies=still.pop())
    motion = fit_motion([ParsedDemonstration(task, driven, ParsedFrames(*still)), corner[1]])
    np.testing.assert_allclose(motion.speeds, fit_motion(corner).speeds, rtol=0.1)


def test_random_actions_are_no_grasps():
    perturbed = demonstrations("FindDupe", range(4), perturb=0.2)
    aside, nearest, _ = fit_motion(perturbed).grasp
    assert aside < BLOCK_SIZE
    assert nearest > ROBOT_RADIUS
