"""MoveToCorner: each clause of the score, scenes that do not fit."""

import math
from dataclasses import replace

import pytest

from magical.errors import InvalidSceneError
from magical.tasks.move_to_corner import DEMO, TASK
from tests.tasks.conftest import Move

HALF = math.sqrt(2) / 2


def at_distance(distance: float) -> tuple[float, float]:
    """A place that far from the top left corner, to its right."""
    return -1 + distance, 1.0


@pytest.mark.parametrize(
    ("distance", "expected"),
    [
        (0.0, 1.0),
        (HALF - 1e-9, 1.0),
        (HALF, 1.0),
        (1.25 * HALF, 0.75),
        (1.5 * HALF, 0.5),
        (1.75 * HALF, 0.25),
        (2 * HALF, 0.0),
        (1.9, 0.0),
    ],
)
def test_score_falls_from_half_the_diagonal_on(
    distance: float, expected: float, moved: Move
) -> None:
    final = moved(DEMO, {0: at_distance(distance)})
    assert TASK.score(DEMO, final) == pytest.approx(expected, abs=1e-12)
    assert TASK.published_code_score(DEMO, final) == TASK.score(DEMO, final)


def test_distance_is_to_the_top_left_corner_in_a_straight_line(moved: Move) -> None:
    diagonal = moved(DEMO, {0: (-1 + 0.6, 1 - 0.8)})  # 1 unit away
    assert TASK.score(DEMO, diagonal) == pytest.approx(2 - math.sqrt(2))
    for corner in ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)):
        assert TASK.score(DEMO, moved(DEMO, {0: corner})) == 0.0


def test_the_demo_scene_scores_zero(moved: Move) -> None:
    assert TASK.score(DEMO, moved(DEMO)) == 0.0


def test_needs_one_block() -> None:
    with pytest.raises(InvalidSceneError, match="expected 1 block, found 0"):
        TASK.validate(replace(DEMO, blocks=()))
