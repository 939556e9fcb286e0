"""The discrete actions among the continuous ones."""

import numpy as np
import pytest

from magical.scene import ACTION_NAMES, NUM_ACTIONS, to_continuous, to_discrete


def test_the_discrete_actions_are_points_and_back() -> None:
    numbers = np.arange(NUM_ACTIONS)
    points = to_continuous(numbers)
    assert points.shape == (NUM_ACTIONS, 3)
    assert len(np.unique(points, axis=0)) == NUM_ACTIONS
    assert points[ACTION_NAMES.index("back-left-closed")].tolist() == [-1.0, 1.0, 1.0]
    np.testing.assert_array_equal(to_discrete(points), numbers)
    np.testing.assert_array_equal(to_discrete(points.astype(np.float32)), numbers)
    assert to_discrete(points[5]) == 5


@pytest.mark.parametrize("point", [(0.5, 0.0, -1.0), (0.0, 0.0, 0.0), (np.nan, 0.0, 1.0)])
def test_other_points_are_no_discrete_actions(point: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"points of the 18 discrete actions.* 1 of 2 are"):
        to_discrete([(0.0, 0.0, 1.0), point])
