"""The discrete actions among the continuous ones."""

import numpy as np
import pytest

from magical.physics.robot import COMMANDS, command
from magical.scene import NUM_ACTIONS, to_continuous, to_discrete
from magical.scene import constants as c
from magical.scene.actions import ACTION_NAMES, MIRRORED_ACTIONS


def test_the_discrete_actions_are_points_and_back() -> None:
    numbers = np.arange(NUM_ACTIONS)
    points = to_continuous(numbers)
    assert points.shape == (NUM_ACTIONS, 3)
    assert len(np.unique(points, axis=0)) == NUM_ACTIONS
    assert points[ACTION_NAMES.index("back-left-closed")].tolist() == [-1.0, 1.0, 1.0]
    np.testing.assert_array_equal(to_discrete(points), numbers)
    np.testing.assert_array_equal(to_discrete(points.astype(np.float32)), numbers)
    assert to_continuous(numbers.reshape(2, 9)).shape == (2, 9, 3)
    assert to_discrete(points[5]) == 5
    assert to_discrete(np.empty((0, 3))).shape == (0,)


@pytest.mark.parametrize("point", [(0.5, 0.0, -1.0), (0.0, 0.0, 0.0), (np.nan, 0.0, 1.0)])
def test_other_points_are_no_discrete_actions(point: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"points of the 18 discrete actions.* 1 of 2 are"):
        to_discrete([(0.0, 0.0, 1.0), point])


def test_commands_are_the_published_speeds_and_linear_in_between() -> None:
    motions = [motion for motion, _ in COMMANDS]
    assert {limit for _, limit in COMMANDS} == {c.TURN_MAX_BIAS}
    assert {speed for speed, _, _ in motions} == {
        0.0,
        c.DRIVE_SPEED_FORWARD,
        c.DRIVE_SPEED_BACK,
    }
    assert {lead for _, lead, _ in motions} == {0.0, c.TURN_LEAD, -c.TURN_LEAD}
    assert {target for _, _, target in motions} == {0.0, c.FINGER_OPEN}
    half, limit = command((0.5, -0.5, 0.0))
    assert half == (c.DRIVE_SPEED_FORWARD / 2, -c.TURN_LEAD, c.FINGER_OPEN / 2)
    assert limit == c.TURN_MAX_BIAS / 2
    assert command((-0.5, 0.0, 1.0)) == ((c.DRIVE_SPEED_BACK / 2, 0.0, 0.0), c.TURN_MAX_BIAS)


def test_mirrored_actions_turn_the_other_way() -> None:
    for action, mirrored in enumerate(MIRRORED_ACTIONS):
        words = ACTION_NAMES[action].split("-")
        words[1] = {"left": "right", "right": "left"}.get(words[1], words[1])
        assert ACTION_NAMES[mirrored] == "-".join(words)
