"""MakeLine: inliers, neighbours, subsets, and both scores of three blocks."""

import math
from dataclasses import replace

import pytest

from magical.errors import InvalidSceneError
from magical.scene import Scene
from magical.tasks.make_line import DEMO, TASK
from magical.tasks.scoring import line_through, longest_line
from tests.tasks.conftest import Move, Point

THREE = replace(DEMO, blocks=DEMO.blocks[:3])
FAR: Point = (-0.9, 0.9)


def score(scene: Scene, places: list[Point], moved: Move) -> float:
    return TASK.score(scene, moved(scene, dict(enumerate(places))))


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2, 2.5])
def test_a_line_in_any_direction_scores_one(angle: float, moved: Move) -> None:
    along = (-0.6, -0.2, 0.2, 0.6)
    places = [(t * math.cos(angle), t * math.sin(angle)) for t in along]
    assert score(DEMO, places, moved) == 1.0
    assert score(DEMO, [places[i] for i in (2, 0, 3, 1)], moved) == 1.0


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ([(-0.5, 0.0), (-0.2, 0.0), (0.1, 0.0), (0.1 + 0.4199, 0.0)], 1.0),
        ([(-0.5, 0.0), (-0.2, 0.0), (0.1, 0.0), (0.1 + 0.4201, 0.0)], 0.5),
        ([(-0.3, 0.0), (0.0, 0.179), (0.1, 0.0), (0.4, 0.0)], 1.0),
        ([(-0.3, 0.0), (0.0, 0.55), (0.1, 0.0), (0.4, 0.0)], 0.5),
        # 0.43 apart, 0.4 along the line
        ([(-0.6, 0.0), (-0.2, 0.17), (0.2, 0.0), (0.6, 0.0)], 1.0),
    ],
)
def test_inliers_are_near_the_line_and_neighbours_close_along_it(
    places: list[Point], expected: float, moved: Move
) -> None:
    assert score(DEMO, places, moved) == expected


@pytest.mark.parametrize(("height", "expected"), [(0.17999, 4), (0.18001, 3), (-0.18001, 3)])
def test_inlier_distance_is_to_the_geometric_line_through_the_pair(
    height: float, expected: int
) -> None:
    blocks = [(-0.3, 0.0), (0.0, 0.0), (0.3, 0.0), (0.1, height)]
    assert line_through(blocks[0], blocks[1], blocks) == expected
    assert line_through(blocks[2], blocks[1], blocks) == expected


def test_the_largest_subset_counts_without_the_pair_that_spans_it() -> None:
    # Three blocks in a row and one far off on the same line: the subset has three.
    row = [(-0.8, 0.0), (0.2, 0.0), (0.5, 0.0), (0.8, 0.0)]
    assert longest_line(row) == 3
    assert longest_line([(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)]) == 1


@pytest.mark.parametrize(
    ("places", "expected", "published"),
    [
        ([(0.0, 0.0), (0.3, 0.0), (0.6, 0.0), FAR], 0.5, 0.5),
        ([(0.0, 0.0), (0.3, 0.0), (0.9, -0.9), FAR], 0.0, 0.0),
        ([(0.0, 0.0), (0.3, 0.0), (0.6, 0.0)], 1.0, 1.0),
        ([(0.0, 0.0), (0.3, 0.0), FAR], 0.5, 0.0),
        ([(0.0, 0.0), (0.9, -0.9), FAR], 0.0, 0.0),
    ],
)
def test_missing_blocks_and_the_published_rule_for_three(
    places: list[Point], expected: float, published: float, moved: Move
) -> None:
    scene = DEMO if len(places) == 4 else THREE
    final = moved(scene, dict(enumerate(places)))
    assert TASK.score(scene, final) == expected
    assert TASK.published_code_score(scene, final) == published


def test_blocks_at_one_place_are_no_error() -> None:
    assert longest_line([(0.0, 0.0), (0.0, 0.0)]) == 1
    assert longest_line([(0.0, 0.0)]) == 1


def test_needs_two_blocks() -> None:
    with pytest.raises(InvalidSceneError, match="at least 2 blocks"):
        TASK.validate(replace(DEMO, blocks=DEMO.blocks[:1]))
