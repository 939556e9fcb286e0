"""Each clause of every task's score, by the appendix's rule and by the published code's."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from magical.errors import InvalidSceneError
from magical.scene import COLOURS, SHAPES, Block, Poses, Scene
from magical.tasks import TASKS, Task, get_task
from magical.tasks.scoring import longest_line
from tests.tasks.conftest import Point, move

HALF = math.sqrt(2) / 2
REGION = get_task("MoveToRegion").demo.regions[0]
LEFT, TOP = REGION.x, REGION.y
RIGHT, BOTTOM = REGION.x + REGION.width, REGION.y - REGION.height
MATCH, FIND, FIX, LINE = (
    get_task(name).demo for name in ("MatchRegions", "FindDupe", "FixColour", "MakeLine")
)
COLOUR = get_task("ClusterColour")
ALIKE = replace(FIND, blocks=(replace(FIND.blocks[6], pose=FIND.blocks[0].pose), *FIND.blocks[1:]))
FREE: Point = (0.8, 0.8)
CENTRES = [region.centre for region in FIX.regions]
CORNERS = [(-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7), (0.7, 0.7)]
CLUSTER = pytest.mark.parametrize("name", ["ClusterColour", "ClusterShape"])


def check(task: str, scene: Scene, final: Poses, expected: float, published: float) -> None:
    assert get_task(task).score(scene, final) == pytest.approx(expected, abs=1e-9)
    assert get_task(task).published_code_score(scene, final) == pytest.approx(published, abs=1e-9)


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((-1.0, 1.0), 1.0),
        ((-1 + HALF, 1.0), 1.0),
        ((-1 + 1.25 * HALF, 1.0), 0.75),
        ((-1 + 1.75 * HALF, 1.0), 0.25),
        ((-1 + 2 * HALF, 1.0), 0.0),
        ((-1 + 0.6, 1 - 0.8), 2 - math.sqrt(2)),  # 1 unit away
        ((-1.0, -1.0), 0.0),
        ((1.0, -1.0), 0.0),
    ],
)
def test_corner_score_falls_with_the_distance(place: Point, expected: float) -> None:
    scene = get_task("MoveToCorner").demo
    check("MoveToCorner", scene, move(scene, {0: place}), expected, expected)


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
    ],
)
def test_region_score_is_whether_the_robots_centre_is_inside(robot: Point, expected: float) -> None:
    scene = get_task("MoveToRegion").demo
    check("MoveToRegion", scene, move(scene, robot=robot), expected, expected)


@pytest.mark.parametrize(
    ("inside", "expected"),
    [
        ((), 0.0),
        ((0, 1), 1.0),
        ((0,), 0.5),
        ((2, 3, 4), 0.0),
        ((0, 1, 2), 2 / 3),
        ((0, 1, 2, 3, 4), 2 / 5),
        ((1, 2, 3, 4), 0.5 * 0.25),
    ],
)
def test_target_bonus_times_distractor_penalty(inside: tuple[int, ...], expected: float) -> None:
    final = move(MATCH, dict.fromkeys(inside, MATCH.regions[0].centre))
    check("MatchRegions", MATCH, final, expected, expected)


@pytest.mark.parametrize(
    ("scene", "inside", "expected", "published"),
    [
        (FIND, (6,), 0.0, 0.0),
        (FIND, (6, 5), 1.0, 1.0),
        (FIND, (6, 5, 0), 2 / 3, 2 / 3),
        (FIND, (6, 5, 0, 1, 2), 2 / 5, 2 / 5),
        (FIND, (6, 0), 0.0, 0.0),
        (FIND, (6, 3), 0.0, 0.0),  # the query's colour, another shape
        (FIND, (5,), 0.0, 0.0),
        # In the published code any two alike suffice.
        (ALIKE, (0, 5), 0.0, 1.0),
        (ALIKE, (0, 5, 1), 0.0, 2 / 3),
        (ALIKE, (0, 5, 6), 1.0, 1.0),
        (ALIKE, (0, 6), 1.0, 1.0),
    ],
)
def test_query_duplicate_and_distractors(
    scene: Scene, inside: tuple[int, ...], expected: float, published: float
) -> None:
    places = {i: FIND.regions[0].centre if i in inside else (0.0, 0.9) for i in range(7)}
    check("FindDupe", scene, move(scene, places), expected, published)


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ({}, 0.0),
        ({2: FREE}, 1.0),
        ({2: CENTRES[0]}, 0.0),  # pushed into another region
        ({2: FREE, 0: FREE}, 0.0),  # another block pushed out as well
        ({2: FREE, 0: CENTRES[1], 1: CENTRES[0]}, 0.0),  # two blocks exchanged
        ({2: FREE, 0: CENTRES[1]}, 0.0),  # two blocks in one region
        ({2: FREE, 1: CENTRES[1]}, 1.0),  # moved within its region
        ({2: FREE, 0: CENTRES[2]}, 0.0),
    ],
)
def test_only_the_mismatch_leaves(places: Mapping[int, Point], expected: float) -> None:
    check("FixColour", FIX, move(FIX, places), expected, expected)


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2, 2.5])
def test_a_line_in_any_direction_and_order_scores_one(angle: float) -> None:
    places = [(t * math.cos(angle), t * math.sin(angle)) for t in (0.2, -0.6, 0.6, -0.2)]
    check("MakeLine", LINE, move(LINE, dict(enumerate(places))), 1.0, 1.0)


@pytest.mark.parametrize(
    ("places", "expected", "published"),
    [
        ([(-0.5, 0.0), (-0.2, 0.0), (0.1, 0.0), (0.1 + 0.4199, 0.0)], 1.0, 1.0),
        ([(-0.5, 0.0), (-0.2, 0.0), (0.1, 0.0), (0.1 + 0.4201, 0.0)], 0.5, 0.5),
        ([(-0.3, 0.0), (0.0, 0.179), (0.1, 0.0), (0.4, 0.0)], 1.0, 1.0),
        ([(-0.3, 0.0), (0.0, 0.55), (0.1, 0.0), (0.4, 0.0)], 0.5, 0.5),
        ([(-0.6, 0.0), (-0.2, 0.17), (0.2, 0.0), (0.6, 0.0)], 1.0, 1.0),  # 0.43 apart, 0.4 along
        ([(0.0, 0.0), (0.3, 0.0), (0.9, -0.9), (-0.9, 0.9)], 0.0, 0.0),
        ([(0.0, 0.0), (0.3, 0.0), (0.6, 0.0)], 1.0, 1.0),
        ([(0.0, 0.0), (0.3, 0.0), (-0.9, 0.9)], 0.5, 0.0),
        ([(0.0, 0.0), (0.9, -0.9), (-0.9, 0.9)], 0.0, 0.0),
    ],
)
def test_blocks_missing_from_the_line(
    places: list[Point], expected: float, published: float
) -> None:
    scene = replace(LINE, blocks=LINE.blocks[: len(places)])
    check("MakeLine", scene, move(scene, dict(enumerate(places))), expected, published)


@pytest.mark.parametrize(
    ("blocks", "expected"),
    [
        ([(-0.8, 0.0), (0.2, 0.0), (0.5, 0.0), (0.8, 0.0)], 3),  # without the pair that spans it
        ([(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)], 1),
        ([(-0.3, 0.0), (0.3, 0.0), (0.0, 0.17999)], 3),
        ([(0.0, 0.0), (0.0, 0.0)], 1),
        ([(0.0, 0.0)], 1),
    ],
)
def test_the_longest_line(blocks: list[Point], expected: int) -> None:
    assert longest_line(blocks) == expected


def value_of(task: str, block: Block) -> int:
    """The number of the block's colour or shape."""
    if task == "ClusterColour":
        return COLOURS.index(block.colour)
    return SHAPES.index(block.shape)


@CLUSTER
def test_blocks_are_clustered_by_the_tasks_own_attribute(name: str) -> None:
    demo = get_task(name).demo
    other = "ClusterShape" if name == "ClusterColour" else "ClusterColour"
    own, mixed = (
        {i: CORNERS[value_of(task, block)] for i, block in enumerate(demo.blocks)}
        for task in (name, other)
    )
    check(name, demo, move(demo, own), 1.0, 1.0)
    check(name, demo, move(demo, dict.fromkeys(range(8), (0.0, 0.0))), 0.0, 0.0)
    assert get_task(name).score(demo, move(demo, mixed)) < 1.0


@pytest.mark.parametrize(
    ("own", "other", "counted", "published"),
    [
        (0.3, 0.3 * 3**0.5 + 1e-6, 16, 16),
        (0.3, 0.3 * 3**0.5 - 1e-6, 15, 16),
        (0.3, 0.3 + 2 * 0.09 + 1e-6, 15, 16),
        (0.3, 0.3 + 2 * 0.09 - 1e-6, 15, 15),
    ],
)
def test_which_distances_count_as_clustered(
    own: float, other: float, counted: int, published: int
) -> None:
    """Block 0 is `own` from its own centroid and `other` from the nearest other one, in units."""
    blocks = [replace(COLOUR.demo.blocks[0], colour=COLOURS[i // 4]) for i in range(16)]
    scene = replace(COLOUR.demo, blocks=tuple(blocks))
    # The own centroid is at the origin: block 0 at (own, 0), the three others at (-own/3, 0).
    places = [(own, 0.0), *[(-own / 3, 0.0)] * 3, *[(own + other, 0.0)] * 4]
    places += [(0.0, 9.0)] * 4 + [(0.0, -9.0)] * 4
    scores = (counted / 16 - 0.5) / 0.5, (published / 16 - 0.75) / 0.25
    check("ClusterColour", scene, move(scene, dict(enumerate(places))), *scores)


@pytest.mark.parametrize(
    ("fraction", "expected", "published"),
    [(0.9, 0.8, 0.6), (0.8, 0.6, 0.2), (0.7, 0.4, 0.0), (0.6, 0.2, 0.0)],
)
def test_score_rises_with_the_fraction_of_clustered_blocks(
    fraction: float, expected: float, published: float
) -> None:
    """Twenty blocks of each colour, a part of them spread over the other corners."""
    blocks = tuple(replace(COLOUR.demo.blocks[0], colour=COLOURS[i // 20]) for i in range(80))
    misplaced = round((1 - fraction) * 20)
    away = [1 + i % 20 % 3 if i % 20 < misplaced else 0 for i in range(80)]
    scene = replace(COLOUR.demo, blocks=blocks)
    final = move(scene, {i: CORNERS[(i // 20 + away[i]) % 4] for i in range(80)})
    check("ClusterColour", scene, final, expected, published)


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_scores_of_any_state_are_floats_between_0_and_1(task: Task) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        final = Poses.at_rest(task.demo)
        final.bodies[:, :2] = rng.uniform(-1, 1, (len(final.bodies), 2))
        for value in (task.score(task.demo, final), task.published_code_score(task.demo, final)):
            assert type(value) is float
            assert 0.0 <= value <= 1.0


def test_poses_of_another_scene_are_rejected() -> None:
    with pytest.raises(InvalidSceneError, match="scene's 7 blocks, found 1"):
        get_task("FindDupe").score(FIND, Poses.at_rest(get_task("MoveToCorner").demo))
