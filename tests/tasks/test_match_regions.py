"""MatchRegions: target bonus, distractor penalty, sampled colours and counts."""

from dataclasses import replace

import numpy as np
import pytest

from magical.errors import InvalidSceneError
from magical.scene import COLOURS, Colour
from magical.tasks.match_regions import DEMO, TASK
from tests.tasks.conftest import Move

TARGETS, DISTRACTORS = (0, 1), (2, 3, 4)


@pytest.mark.parametrize(
    ("inside", "expected"),
    [
        ((), 0.0),
        (TARGETS, 1.0),
        ((0,), 0.5),
        ((1,), 0.5),
        (DISTRACTORS, 0.0),
        ((0, 1, 2), 2 / 3),
        ((0, 1, 2, 3, 4), 2 / 5),
        ((0, 2), 0.5 * 0.5),
        ((1, 2, 3, 4), 0.5 * 0.25),
    ],
)
def test_target_bonus_times_distractor_penalty(
    inside: tuple[int, ...], expected: float, moved: Move
) -> None:
    final = moved(DEMO, dict.fromkeys(inside, DEMO.regions[0].centre))
    assert TASK.score(DEMO, final) == pytest.approx(expected)
    assert TASK.published_code_score(DEMO, final) == TASK.score(DEMO, final)


def test_a_block_on_the_edge_is_inside(moved: Move) -> None:
    region = DEMO.regions[0]
    edge = (region.x, region.y)
    assert TASK.score(DEMO, moved(DEMO, {0: edge})) == 0.5
    assert TASK.score(DEMO, moved(DEMO, {0: (edge[0] - 1e-6, edge[1])})) == 0.0


def test_colour_keeps_the_targets_and_the_order_of_the_other_colours() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        scene, _ = TASK.sample("TestColour", rng)
        first, second, third = (c for c in COLOURS if c != scene.regions[0].colour)
        target = scene.regions[0].colour
        assert [b.colour for b in scene.blocks] == [target, target, second, third, third]
        assert first not in [b.colour for b in scene.blocks]
        assert [b.shape for b in scene.blocks] == [b.shape for b in DEMO.blocks]


def test_count_plus_has_targets_first_and_at_most_two_of_each_colour() -> None:
    rng = np.random.default_rng(0)
    scenes = [TASK.sample("TestCountPlus", rng)[0] for _ in range(200)]
    for scene in scenes:
        colours = [b.colour for b in scene.blocks]
        target = scene.regions[0].colour
        order = [target, *(c for c in COLOURS if c != target)]
        assert colours == sorted(colours, key=order.index)
        assert 1 <= colours.count(target) <= 2
        assert all(colours.count(colour) <= 2 for colour in order)
    assert {len(scene.blocks) for scene in scenes} >= {2, 3, 4, 5, 6, 7}
    assert TASK.max_blocks == 8


def test_needs_a_region_and_a_target() -> None:
    with pytest.raises(InvalidSceneError, match="expected 1 goal region"):
        TASK.validate(replace(DEMO, regions=()))
    red = (replace(DEMO.regions[0], colour=Colour.RED),)
    with pytest.raises(InvalidSceneError, match="block of the region's colour red"):
        TASK.validate(replace(DEMO, regions=red))
