"""Control steps that remain, in an empty workspace, where they are known."""

import numpy as np
import pytest

from magical_goals.planning.motion import PRIOR, Floats
from magical_goals.planning.planner import FIT, steps_to_grasp, steps_to_place
from magical_goals.planning.routes import Search

NOTHING = np.zeros((0, 2))
MOTION = PRIOR._replace(grasp=np.array([0.1, 0.25, 0.3]))
BACK, AHEAD, SPIN = MOTION.speeds[0]
FACING_UP, FACING_LEFT, FACING_DOWN = 0.0, np.pi / 2, np.pi


def robots(*angles: float) -> Floats:
    return np.array([(0.0, -0.4, angle) for angle in angles])


@pytest.mark.parametrize("reach", [0.0, 0.28])
def test_the_robot_turns_and_drives_forwards_or_backwards_to_a_place(reach: float) -> None:
    place, ends = np.array([0.0, 0.4]), robots(FACING_UP, FACING_LEFT, FACING_DOWN)
    found = steps_to_place(place, ends, NOTHING, MOTION.speeds[0], Search(), reach)
    ahead, backwards = (0.8 - reach) / AHEAD, (0.8 + reach) / BACK
    quarter = np.pi / 2 / SPIN
    expected = [ahead, quarter + min(ahead, backwards), min(2 * quarter + ahead, backwards)]
    np.testing.assert_allclose(found, expected)


def test_the_robot_turns_and_drives_on_to_a_near_block() -> None:
    block = np.array([0.0, 0.0])
    found = steps_to_grasp(block, robots(FACING_UP, 0.5), NOTHING, MOTION, Search())
    ahead = (0.4 - 0.25) / AHEAD
    aside = FIT * 0.1 / 0.4  # rad: a block may lie so far aside
    np.testing.assert_allclose(found, [ahead, ahead + (0.5 - aside) / SPIN])
