"""MoveToRegion: inside or not, edges included."""

from dataclasses import replace

import pytest

from magical.errors import InvalidSceneError
from magical.tasks.move_to_region import DEMO, TASK
from tests.tasks.conftest import Move

REGION = DEMO.regions[0]
LEFT, TOP = REGION.x, REGION.y
RIGHT, BOTTOM = REGION.x + REGION.width, REGION.y - REGION.height


@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        (REGION.centre, 1.0),
        ((LEFT, TOP), 1.0),
        ((RIGHT, BOTTOM), 1.0),
        ((LEFT - 1e-6, TOP), 0.0),
        ((RIGHT + 1e-6, BOTTOM), 0.0),
        ((LEFT, TOP + 1e-6), 0.0),
        ((RIGHT, BOTTOM - 1e-6), 0.0),
        (DEMO.robot[:2], 0.0),
    ],
)
def test_score_is_whether_the_robots_centre_is_inside(
    robot: tuple[float, float], expected: float, moved: Move
) -> None:
    final = moved(DEMO, robot=robot)
    assert TASK.score(DEMO, final) == expected
    assert TASK.published_code_score(DEMO, final) == expected


def test_needs_a_region() -> None:
    with pytest.raises(InvalidSceneError, match="expected 1 goal region"):
        TASK.validate(replace(DEMO, regions=()))
