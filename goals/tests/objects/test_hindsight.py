"""Goals found in hindsight, in episodes made by hand."""

import numpy as np
import pytest

from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.objects.data import find_goals, track
from magical_goals.objects.parser import FAR, MAX_BLOCKS, ParsedFrames


def episode():
    """The robot brings block 1 to (0.5, 0), nudges block 0 by 0.02, and then drives away."""
    robot = np.zeros((31, 3))
    robot[:, 2] = -np.pi / 2  # facing +x
    blocks = np.tile([[0.3, 0.5], [0.28, 0.0]], (31, 1, 1)).astype(float)
    for t in range(31):
        robot[t, 0] = 0.022 * min(max(t - 5, 0), 10) - 0.03 * max(t - 22, 0)
        blocks[t, 1, 0] = 0.28 + 0.022 * min(max(t - 5, 0), 10)
        blocks[t, 0, 1] = 0.5 + 0.01 * min(max(t - 18, 0), 2)
    return robot, blocks


def parsed(robot, blocks, colours):
    """Frames of closed fingers, without regions; blocks are of one shape."""
    count, shapes = len(robot), np.where(colours >= 0, 0, -1)
    nothing = np.zeros((count, 3, 4)), np.full((count, 3), -1)
    return ParsedFrames(robot, np.zeros((count, 2)), blocks, colours, shapes, *nothing)


def test_the_target_is_the_block_that_is_moved_next_and_then_the_robot():
    robot, blocks = episode()
    targets, destinations = find_goals(robot, blocks, np.ones(30, np.bool_), 30)
    assert targets.tolist() == [1] * 15 + [ROBOT_TARGET] * 15
    assert np.allclose(destinations[:15], [0.5, 0.0])
    assert np.allclose(destinations[15:], robot[-1, :2])


def test_what_random_actions_move_is_no_goal():
    robot, blocks = episode()
    targets, _ = find_goals(robot, blocks, np.arange(30) >= 15, 30)
    assert (targets == ROBOT_TARGET).all()


def test_a_block_that_glides_on_from_a_random_push_is_not_moved_on_purpose():
    steps = np.zeros(16)
    steps[1:5] = 0.04  # a carry
    steps[8:13] = 0.03, 0.03, 0.02, 0.012, 0.007  # pushed in steps 8 and 9
    x = np.concatenate([[0.0], np.cumsum(steps)])
    blocks = np.stack([x, np.zeros_like(x)], axis=1)[:, None]
    robot = np.zeros((len(x), 3))
    intended = ~np.isin(np.arange(16), (8, 9))
    targets, destinations = find_goals(robot, blocks, intended, 16)
    assert targets.tolist() == [0] * 5 + [ROBOT_TARGET] * 11
    assert destinations[0].tolist() == pytest.approx([0.16, 0.0])


def test_tracking_keeps_numbers_when_blocks_are_found_in_another_order_or_not_at_all():
    blocks = np.full((3, MAX_BLOCKS, 2), FAR)
    colours = np.full((3, MAX_BLOCKS), -1)
    blocks[0, :2], colours[0, :2] = [[0.0, 0.0], [0.5, 0.5]], [2, 1]
    blocks[1, :2], colours[1, :2] = [[0.52, 0.5], [0.01, 0.0]], [1, 2]
    blocks[2, :1], colours[2, :1] = [[0.02, 0.0]], [2]  # the other one is hidden
    tracked = track(parsed(np.zeros((3, 3)), blocks, colours))
    assert np.allclose(tracked.blocks[:, 0], [[0.0, 0.0], [0.01, 0.0], [0.02, 0.0]])
    assert np.allclose(tracked.blocks[:, 1], [[0.5, 0.5], [0.52, 0.5], [0.52, 0.5]])
    assert tracked.colours[:, :2].tolist() == [[2, 1]] * 3
