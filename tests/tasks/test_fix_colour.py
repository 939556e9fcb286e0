"""FixColour: each clause of the score, and the sampled mismatch."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from magical.errors import InvalidSceneError
from magical.scene import Colour, Pose
from magical.tasks.fix_colour import DEMO, TASK, mismatched
from tests.tasks.conftest import Move

MISMATCH = 2
FREE = (0.8, 0.8)
CENTRES = [region.centre for region in DEMO.regions]


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ({}, 0.0),  # nothing done
        ({MISMATCH: FREE}, 1.0),
        ({MISMATCH: CENTRES[0]}, 0.0),  # pushed into another region
        ({MISMATCH: FREE, 0: FREE}, 0.0),  # another block pushed out as well
        ({MISMATCH: FREE, 0: CENTRES[1], 1: CENTRES[0]}, 0.0),  # two blocks exchanged
        ({MISMATCH: FREE, 0: CENTRES[1]}, 0.0),  # two blocks in one region
        ({MISMATCH: FREE, 1: CENTRES[1]}, 1.0),  # moved within its region
        ({0: FREE}, 0.0),
        ({MISMATCH: FREE, 0: CENTRES[MISMATCH]}, 0.0),
    ],
)
def test_only_the_mismatch_leaves_and_everything_else_stays(
    places: dict[int, tuple[float, float]], expected: float, moved: Move
) -> None:
    final = moved(DEMO, places)
    assert TASK.score(DEMO, final) == expected
    assert TASK.published_code_score(DEMO, final) == expected


@pytest.mark.parametrize("variant", TASK.variants)
def test_exactly_one_block_is_mismatched(variant: str) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        assert len(mismatched(TASK.sample(variant, rng)[0])) == 1


def test_the_mismatch_is_uniform_over_blocks_and_other_colours() -> None:
    rng = np.random.default_rng(0)
    counts: Counter[tuple[int, Colour, Colour]] = Counter()
    for _ in range(3600):
        scene, _ = TASK.sample("TestColour", rng)
        (odd,) = mismatched(scene)
        counts[odd, scene.regions[odd].colour, scene.blocks[odd].colour] += 1
    assert len(counts) == 3 * 4 * 3  # 100 of each expected
    assert 60 < min(counts.values())
    assert max(counts.values()) < 150


def test_count_plus_has_two_or_three_pairs() -> None:
    rng = np.random.default_rng(0)
    scenes = [TASK.sample("TestCountPlus", rng)[0] for _ in range(30)]
    assert {(len(s.blocks), len(s.regions)) for s in scenes} == {(2, 2), (3, 3)}


def test_scenes_that_do_not_fit() -> None:
    with pytest.raises(InvalidSceneError, match="a region for every block"):
        TASK.validate(replace(DEMO, regions=DEMO.regions[:2]))
    with pytest.raises(InvalidSceneError, match="exactly 1 block of another colour"):
        TASK.validate(replace(DEMO, blocks=DEMO.blocks[:2], regions=DEMO.regions[:2]))
    outside = replace(DEMO.blocks[0], pose=Pose(-0.3, -0.8, 0.0))
    with pytest.raises(InvalidSceneError, match="block 0 alone inside region 0, found blocks"):
        TASK.validate(replace(DEMO, blocks=(outside, *DEMO.blocks[1:])))
    around = replace(DEMO.regions[1], y=0.1, height=1.0)  # the first block, too
    with pytest.raises(InvalidSceneError, match="block 1 alone inside region 1, found blocks"):
        TASK.validate(replace(DEMO, regions=(DEMO.regions[0], around, *DEMO.regions[2:])))
