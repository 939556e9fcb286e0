"""Sampled scenes: what each variant changes, the rules of placement, and bounded failure."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical.errors import InvalidSceneError, PlacementError, UnknownNameError
from magical.scene import (
    COLOURS,
    DYNAMICS_RANGES,
    SHAPES,
    Block,
    Colour,
    Dynamics,
    Pose,
    Region,
    Scene,
    Shape,
)
from magical.tasks import TASKS, VARIANTS, Axis, Placement, Task, get_task, placement
from magical.tasks.fix_colour import mismatched
from magical.tasks.placement import sample_placement
from tests.tasks.conftest import sampled, scenes_of
from tests.tasks.placement_rules import check_placement

ALL_TASKS = pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
APPENDIX = [task for task in TASKS.values() if task.section]
ALL_VARIANTS = pytest.mark.parametrize(
    ("task", "variant"),
    [(task, variant) for task in TASKS.values() for variant in task.variants],
    ids=lambda value: getattr(value, "name", value),
)
SAMPLED = pytest.mark.parametrize("variant", ["TestColour", "TestShape", "TestCountPlus"])
LACKING = {  # appendix, Table 2
    "MoveToCorner": {"TestLayout", "TestCountPlus"},
    "MoveToRegion": {"TestShape", "TestCountPlus"},
}


def test_variants_are_those_of_the_appendix() -> None:
    assert sum(len(task.variants) for task in APPENDIX) == 60
    for task in APPENDIX:
        assert set(VARIANTS) - set(task.variants) == LACKING.get(task.name, set())


@pytest.mark.parametrize(
    ("name", "axes"),
    [
        ("MoveToCorner", Axis.JITTER | Axis.COLOUR | Axis.SHAPE | Axis.DYNAMICS),
        ("MoveToRegion", Axis.LAYOUT | Axis.COLOUR | Axis.DYNAMICS),
        ("MakeLine", VARIANTS["TestCountPlus"] | Axis.DYNAMICS),
    ],
)
def test_all_varies_every_axis_of_the_task(name: str, axes: Axis) -> None:
    assert TASKS[name].axes_of("TestAll") == axes


def test_a_missing_variant_raises_with_the_available_ones() -> None:
    task = get_task("MoveToRegion")
    with pytest.raises(UnknownNameError) as error:
        task.sample("TestShape", np.random.default_rng(0))
    known = ", ".join(task.variants)
    assert str(error.value) == f"MoveToRegion has no variant 'TestShape'; it has: {known}"
    with pytest.raises(UnknownNameError, match="did you mean 'TestColour'"):
        task.axes_of("TestColor")


@ALL_VARIANTS
def test_the_same_seed_samples_the_same_scene(task: Task, variant: str) -> None:
    first, again, other = (task.sample(variant, np.random.default_rng(s)) for s in (5, 5, 6))
    assert first == again
    assert (first != other) == (variant != "Demo")


@ALL_VARIANTS
def test_only_the_variants_axes_change(task: Task, variant: str) -> None:
    axes, demo = task.axes_of(variant), task.demo
    scenes = scenes_of(task.name, variant)
    forces = [dynamics for _, dynamics in sampled(task.name, variant)]
    changes = {
        Axis.JITTER | Axis.LAYOUT: lambda s: (s.robot, [b.pose for b in s.blocks]),
        Axis.SHAPE: lambda s: [b.shape for b in s.blocks],
        Axis.COLOUR: lambda s: [each.colour for each in (*s.blocks, *s.regions)],
    }
    for either, read in changes.items():
        assert any(read(scene) != read(demo) for scene in scenes) == bool(axes & either)
    assert {scene.robot_first for scene in scenes} == {demo.robot_first}
    assert any(d != Dynamics() for d in forces) == (Axis.DYNAMICS in axes)
    values = np.array([[*dynamics.to_dict().values()] for dynamics in forces])
    low, high = np.transpose(DYNAMICS_RANGES)
    assert ((low <= values) & (values <= high)).all()


@ALL_VARIANTS
def test_sampled_scenes_keep_the_rules_of_placement(task: Task, variant: str) -> None:
    for scene in scenes_of(task.name, variant):
        check_placement(task, variant, scene)


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("MoveToCorner", {1}),
        ("MoveToRegion", {0}),
        ("MatchRegions", set(range(1, 9))),
        ("MakeLine", {3, 4}),
        ("FindDupe", {3, 4, 5, 6, 7}),
        ("FixColour", {2, 3}),
        ("ClusterColour", {7, 8, 9, 10}),
        ("ClusterShape", {7, 8, 9, 10}),
    ],
)
def test_numbers_of_blocks_and_regions(name: str, counts: set[int]) -> None:
    task, rng = get_task(name), np.random.default_rng(0)
    scenes = [task.randomise_fn(task.demo, task.axes_of("TestAll"), rng) for _ in range(500)]
    assert {len(scene.blocks) for scene in scenes} == counts
    assert max(counts) == task.max_blocks
    regions = {len(scene.regions) for scene in scenes}
    assert regions == ({2, 3} if name == "FixColour" else {len(task.demo.regions)})
    assert max(regions) == task.max_regions


def test_match_regions_keeps_targets_first_and_the_order_of_the_other_colours() -> None:
    for scene in scenes_of("MatchRegions", "TestColour"):
        target = scene.regions[0].colour
        _, second, third = (c for c in COLOURS if c != target)
        assert [b.colour for b in scene.blocks] == [target, target, second, third, third]
    for scene in scenes_of("MatchRegions", "TestCountPlus"):
        colours = [b.colour for b in scene.blocks]
        target = scene.regions[0].colour
        order = [target, *(c for c in COLOURS if c != target)]
        assert colours == sorted(colours, key=order.index)
        assert target in colours
        assert max(map(colours.count, order)) <= 2


@SAMPLED
def test_find_dupe_has_a_duplicate_and_a_region_of_the_querys_colour(variant: str) -> None:
    for scene in scenes_of("FindDupe", variant):
        *_, duplicate, query = scene.blocks
        assert (duplicate.shape, duplicate.colour) == (query.shape, query.colour)
        assert scene.regions[0].colour == query.colour
        assert not scene.regions[0].contains(duplicate.pose.x, duplicate.pose.y)


def test_the_mismatch_is_uniform_over_blocks_and_other_colours() -> None:
    task, rng = get_task("FixColour"), np.random.default_rng(0)
    counts: Counter[tuple[int, Colour, Colour]] = Counter()
    for _ in range(3600):
        scene = task.randomise_fn(task.demo, Axis.COLOUR, rng)
        (odd,) = mismatched(scene)
        counts[odd, scene.regions[odd].colour, scene.blocks[odd].colour] += 1
    assert len(counts) == 3 * 4 * 3  # 100 of each expected
    assert 60 < min(counts.values())
    assert max(counts.values()) < 150


@SAMPLED
@pytest.mark.parametrize("name", ["ClusterColour", "ClusterShape"])
def test_all_four_values_are_present_in_random_order(name: str, variant: str) -> None:
    scenes = scenes_of(name, variant)
    first = [scene.blocks[0] for scene in scenes]
    for blocks in (*(scene.blocks for scene in scenes), first):
        if variant != "TestShape":
            assert {block.colour for block in blocks} == set(COLOURS)
        if variant != "TestColour":
            assert {block.shape for block in blocks} == set(SHAPES)


CROWDED = Scene(
    Pose(0.0, 0.0, 0.0),
    tuple(Block(Shape.CIRCLE, Colour.RED, Pose(0.0, 0.0, 0.0)) for _ in range(80)),
)
CORNER = Region(Colour.RED, -0.999, 0.999, 0.9, 0.9)
EVERYWHERE = Region(Colour.RED, -0.999, 0.999, 1.99, 1.99)


@pytest.mark.parametrize(
    ("scene", "axes", "what"),
    [
        (CROWDED, Axis.LAYOUT, r"block \d+ \(red circle\)"),
        (replace(CROWDED, regions=(CORNER,) * 4), Axis.JITTER, r"region 1 \(red\)"),
        (replace(CROWDED, regions=(EVERYWHERE,)), Axis.JITTER, "the robot"),
    ],
)
def test_no_room_is_an_error_after_a_bounded_number_of_attempts(
    scene: Scene, axes: Axis, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(placement, "MAX_PROPOSALS", 50)
    monkeypatch.setattr(placement, "MAX_RESTARTS", 3)
    expected = rf"found no room for {what} in 50 proposals, in the last of 3 attempts; use fewer"
    with pytest.raises(PlacementError, match=expected):
        sample_placement(scene, axes, np.random.default_rng(0), Placement(region_size=(0.0, 2.0)))


def test_a_scene_without_room_is_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve blocks seldom all find room in eight proposals each, but some attempt succeeds."""
    monkeypatch.setattr(placement, "MAX_PROPOSALS", 8)
    scene, scenes = replace(CROWDED, blocks=CROWDED.blocks[:12]), []
    for restarts in (1, 10_000):
        monkeypatch.setattr(placement, "MAX_RESTARTS", restarts)
        try:
            rng = np.random.default_rng(0)
            scenes.append(sample_placement(scene, Axis.LAYOUT, rng, Placement()))
        except PlacementError:
            scenes.append(None)
    assert scenes[0] is None
    assert scenes[1] is not None


LINE, FIX = TASKS["MakeLine"], TASKS["FixColour"]
FIXED = FIX.sample("TestLayout", np.random.default_rng(0))[0]
REGION, SECOND, *REST = FIXED.regions
SHIFTED = FIXED.blocks[0].pose._replace(x=REGION.x + 0.01)
BREAKS: dict[str, tuple[Task, str, Scene, dict[str, Any]]] = {
    "angle": (LINE, "TestLayout", LINE.demo, {"robot": Pose(0.702, -0.255, 4.0)}),
    "moved": (LINE, "TestColour", LINE.demo, {"robot": Pose(0.703, -0.255, 0.347)}),
    "too far": (LINE, "TestJitter", LINE.demo, {"robot": Pose(0.702, -0.255 + 0.0251, 0.347)}),
    "turned": (LINE, "TestJitter", LINE.demo, {"robot": Pose(0.702, -0.255, 0.347 + 0.158)}),
    "count": (LINE, "TestLayout", LINE.demo, {"blocks": LINE.demo.blocks[:3]}),
    "size": (FIX, "TestLayout", FIXED, {"regions": (replace(REGION, width=0.51), SECOND, *REST)}),
    "not enclosed": (
        *(FIX, "TestLayout", FIXED),
        {"blocks": (replace(FIXED.blocks[0], pose=SHIFTED), *FIXED.blocks[1:])},
    ),
    "overlap": (
        *(FIX, "TestLayout", FIXED),
        {"regions": (REGION, replace(SECOND, x=REGION.x + 0.01, y=REGION.y), *REST)},
    ),
}


@pytest.mark.parametrize(("task", "variant", "scene", "change"), BREAKS.values(), ids=BREAKS)
def test_the_check_of_the_rules_rejects(
    task: Task, variant: str, scene: Scene, change: dict[str, Any]
) -> None:
    check_placement(task, variant, scene)
    with pytest.raises(InvalidSceneError):
        check_placement(task, variant, replace(scene, **change))
