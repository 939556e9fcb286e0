"""FindDupe: query, duplicate, distractors, both scores; sampled duplicates."""

from dataclasses import replace

import numpy as np
import pytest

from magical.errors import InvalidSceneError
from magical.scene import Pose, Scene
from magical.tasks.find_dupe import DEMO, TASK
from tests.tasks.conftest import Move

QUERY, DUPLICATE = 6, 5
TWO = replace(DEMO, blocks=(replace(DEMO.blocks[-1], pose=DEMO.blocks[0].pose), *DEMO.blocks[1:]))
IN, OUT = DEMO.regions[0].centre, (0.0, 0.9)


@pytest.mark.parametrize(
    ("scene", "inside", "expected", "published"),
    [
        (DEMO, (QUERY,), 0.0, 0.0),
        (DEMO, (), 0.0, 0.0),
        (DEMO, (QUERY, DUPLICATE), 1.0, 1.0),
        (DEMO, (QUERY, DUPLICATE, 0), 2 / 3, 2 / 3),
        (DEMO, (QUERY, DUPLICATE, 0, 1, 2), 2 / 5, 2 / 5),
        (DEMO, (QUERY, 0), 0.0, 0.0),
        (DEMO, (QUERY, 3), 0.0, 0.0),  # the query's colour, another shape
        (DEMO, (DUPLICATE,), 0.0, 0.0),
        (DEMO, (DUPLICATE, 0), 0.0, 0.0),
        # In the published code any two alike suffice.
        (TWO, (0, DUPLICATE), 0.0, 1.0),
        (TWO, (0, DUPLICATE, 1), 0.0, 2 / 3),
        (TWO, (0, DUPLICATE, QUERY), 1.0, 1.0),
        (TWO, (0, QUERY), 1.0, 1.0),
    ],
)
def test_query_duplicate_and_distractors(
    scene: Scene, inside: tuple[int, ...], expected: float, published: float, moved: Move
) -> None:
    final = moved(scene, {i: IN if i in inside else OUT for i in range(7)})
    assert TASK.score(scene, final) == pytest.approx(expected)
    assert TASK.published_code_score(scene, final) == pytest.approx(published)


@pytest.mark.parametrize("variant", ["TestColour", "TestShape", "TestCountPlus", "TestAll"])
def test_there_is_always_a_duplicate_and_the_region_has_the_querys_colour(variant: str) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        scene, _ = TASK.sample(variant, rng)
        *_, duplicate, query = scene.blocks
        assert (duplicate.shape, duplicate.colour) == (query.shape, query.colour)
        assert scene.regions[0].colour == query.colour
        assert scene.regions[0].contains(query.pose.x, query.pose.y)
        assert not scene.regions[0].contains(duplicate.pose.x, duplicate.pose.y)


def test_count_plus_has_one_to_five_other_blocks() -> None:
    rng = np.random.default_rng(0)
    found = {len(TASK.sample("TestCountPlus", rng)[0].blocks) for _ in range(100)}
    assert found == {3, 4, 5, 6, 7}


def test_scenes_that_do_not_fit() -> None:
    with pytest.raises(InvalidSceneError, match="expected 1 goal region"):
        TASK.validate(replace(DEMO, regions=()))
    with pytest.raises(InvalidSceneError, match="expected a duplicate"):
        TASK.validate(replace(DEMO, blocks=(*DEMO.blocks[:-2], DEMO.blocks[-1])))
    outside = replace(DEMO.blocks[-1], pose=Pose(0.2, 0.0, 0.0))
    inside = replace(DEMO.blocks[0], pose=Pose(-0.57, -0.72, 0.0))
    for blocks in (*DEMO.blocks[:-1], outside), (inside, *DEMO.blocks[1:]):
        with pytest.raises(InvalidSceneError, match="alone inside the region, found blocks"):
            TASK.validate(replace(DEMO, blocks=blocks))
