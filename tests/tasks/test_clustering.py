"""ClusterColour and ClusterShape: both scores, at constructed distances."""

from dataclasses import replace

import numpy as np
import pytest

from magical.errors import InvalidSceneError
from magical.scene import COLOURS, SHAPES, Block, Pose, Poses, Scene
from magical.tasks import Task
from magical.tasks.cluster_colour import TASK as CLUSTER_COLOUR
from magical.tasks.cluster_shape import TASK as CLUSTER_SHAPE
from magical.tasks.scoring import centroid_distances, positions
from tests.tasks.conftest import Move

CORNERS = [(-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7), (0.7, 0.7)]
BOTH = pytest.mark.parametrize("task", [CLUSTER_COLOUR, CLUSTER_SHAPE], ids=lambda task: task.name)


def value_of(task: Task, block: Block) -> int:
    """The number of the block's colour or shape."""
    if task is CLUSTER_COLOUR:
        return COLOURS.index(block.colour)
    return SHAPES.index(block.shape)


def colours(scene: Scene) -> list[str]:
    return [block.colour for block in scene.blocks]


def clustered(task: Task) -> dict[int, tuple[float, float]]:
    """Every block at its value's corner."""
    return {i: CORNERS[value_of(task, block)] for i, block in enumerate(task.demo.blocks)}


@BOTH
def test_perfect_clusters_score_one_and_a_single_place_zero(task: Task, moved: Move) -> None:
    for places, expected in ((clustered(task), 1.0), (dict.fromkeys(range(8), (0.0, 0.0)), 0.0)):
        final = moved(task.demo, places)
        assert task.score(task.demo, final) == expected
        assert task.published_code_score(task.demo, final) == expected


@BOTH
def test_the_other_tasks_attribute_does_not_count(task: Task, moved: Move) -> None:
    other = CLUSTER_SHAPE if task is CLUSTER_COLOUR else CLUSTER_COLOUR
    mixed = {i: CORNERS[value_of(other, b)] for i, b in enumerate(task.demo.blocks)}
    assert task.score(task.demo, moved(task.demo, mixed)) < 1.0


def line_of_four(own: float, other: float) -> tuple[Scene, Poses]:
    """Sixteen blocks: the first four of one colour, one of which at the given distances.

    Block 0 is `own` from its own centroid and `other` from the nearest other one, in units.
    """
    task = CLUSTER_COLOUR
    blocks = [replace(task.demo.blocks[0], colour=COLOURS[i // 4]) for i in range(16)]
    scene = replace(task.demo, blocks=tuple(blocks))
    # Own centroid at the origin: block 0 at (own, 0), the three others at (-own/3, 0).
    places = [(own, 0.0), *[(-own / 3, 0.0)] * 3, *[(own + other, 0.0)] * 4]
    places += [(0.0, 9.0)] * 4 + [(0.0, -9.0)] * 4
    moved_blocks = [
        replace(b, pose=Pose(x, y, 0.0)) for b, (x, y) in zip(blocks, places, strict=True)
    ]
    return scene, Poses.at_rest(replace(scene, blocks=tuple(moved_blocks)))


@pytest.mark.parametrize(("own", "other"), [(0.3, 0.5), (0.1, 0.9)])
def test_distances_are_squared_and_to_the_nearest_other_centroid(own: float, other: float) -> None:
    scene, poses = line_of_four(own, other)
    found, nearest = centroid_distances(colours(scene), np.array(positions(scene, poses)))
    assert found[0] == pytest.approx(own**2)
    assert nearest[0] == pytest.approx(other**2)


@pytest.mark.parametrize(
    ("own", "other", "counted"),
    [(0.30, 0.30 * 3**0.5 + 1e-6, 16), (0.30, 0.30 * 3**0.5 - 1e-6, 15), (0.3, 0.3, 15)],
)
def test_own_squared_distance_is_less_than_a_third(own: float, other: float, counted: int) -> None:
    score = CLUSTER_COLOUR.score(*line_of_four(own, other))
    assert score == pytest.approx((counted / 16 - 0.5) / 0.5)


@pytest.mark.parametrize(
    ("own", "other", "counted"),
    [(0.30, 0.30 + 2 * 0.09 + 1e-6, 16), (0.30, 0.30 + 2 * 0.09 - 1e-6, 15)],
)
def test_published_margin_is_twice_the_squared_distance(
    own: float, other: float, counted: int
) -> None:
    score = CLUSTER_COLOUR.published_code_score(*line_of_four(own, other))
    assert score == pytest.approx((counted / 16 - 0.75) / 0.25)


def partly_clustered(fraction: float) -> tuple[Scene, Poses]:
    """Twenty blocks of each colour, a part of them spread over the other corners."""
    task, misplaced = CLUSTER_COLOUR, round((1 - fraction) * 20)
    blocks, places = [], []
    for value, colour in enumerate(COLOURS):
        for i in range(20):
            blocks.append(replace(task.demo.blocks[0], colour=colour))
            places.append(CORNERS[(value + (1 + i % 3 if i < misplaced else 0)) % 4])
    scene = replace(task.demo, blocks=tuple(blocks))
    final = [replace(b, pose=Pose(*xy, 0.0)) for b, xy in zip(blocks, places, strict=True)]
    return scene, Poses.at_rest(replace(scene, blocks=tuple(final)))


@pytest.mark.parametrize(
    ("fraction", "expected", "published"),
    [(1.0, 1.0, 1.0), (0.9, 0.8, 0.6), (0.8, 0.6, 0.2), (0.7, 0.4, 0.0), (0.6, 0.2, 0.0)],
)
def test_score_rises_with_the_fraction_of_clustered_blocks(
    fraction: float, expected: float, published: float
) -> None:
    scene, final = partly_clustered(fraction)
    assert CLUSTER_COLOUR.score(scene, final) == pytest.approx(expected)
    assert CLUSTER_COLOUR.published_code_score(scene, final) == pytest.approx(published)


@pytest.mark.parametrize("apart", [1, 2])
def test_half_or_fewer_clustered_score_zero(apart: int, moved: Move) -> None:
    """Two blocks of each colour; `apart` colours have corners of their own, the rest one place."""
    demo = CLUSTER_COLOUR.demo
    blocks = tuple(replace(b, colour=COLOURS[i // 2]) for i, b in enumerate(demo.blocks))
    scene = replace(demo, blocks=blocks)
    places = {i: CORNERS[i // 2] if i // 2 < apart else (0.0, 0.0) for i in range(8)}
    final = moved(scene, places)
    own, other = centroid_distances(colours(scene), np.array(positions(scene, final)))
    assert np.count_nonzero(own < other / 3) == 2 * apart
    assert CLUSTER_COLOUR.score(scene, final) == 0.0


@BOTH
@pytest.mark.parametrize("variant", ["TestColour", "TestShape", "TestCountPlus", "TestAll"])
def test_all_four_values_are_present(task: Task, variant: str) -> None:
    rng = np.random.default_rng(0)
    scenes = [task.sample(variant, rng)[0] for _ in range(50)]
    first = [scene.blocks[0] for scene in scenes]  # they are in random order
    for blocks in (*(scene.blocks for scene in scenes), first):
        if variant != "TestShape":
            assert {block.colour for block in blocks} == set(COLOURS)
        if variant != "TestColour":
            assert {block.shape for block in blocks} == set(SHAPES)


@BOTH
def test_counts_and_horizons(task: Task) -> None:
    rng = np.random.default_rng(0)
    found = {len(task.sample("TestCountPlus", rng)[0].blocks) for _ in range(60)}
    assert found == {7, 8, 9, 10}
    assert (task.horizon, task.published_horizon) == (320, 240)


@BOTH
def test_scenes_without_one_of_the_values_do_not_fit(task: Task) -> None:
    left = tuple(b for b in task.demo.blocks if value_of(task, b) != 0)
    with pytest.raises(InvalidSceneError, match="expected at least one"):
        task.validate(replace(task.demo, blocks=left))
