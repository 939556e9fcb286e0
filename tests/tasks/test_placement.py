"""Placement by bounded rejection sampling: the rules, and failure that changes nothing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical.errors import InvalidSceneError, PlacementError
from magical.scene import Block, Colour, Pose, Region, Scene, Shape
from magical.tasks import TASKS, Axis, Placement, Task, placement
from magical.tasks.placement import sample_placement
from tests.tasks.placement_rules import check_placement

SCENES = 100  # of each environment
ENVIRONMENTS = [(task, variant) for task in TASKS.values() for variant in task.variants]
CROWDED = Scene(
    Pose(0.0, 0.0, 0.0),
    tuple(Block(Shape.CIRCLE, Colour.RED, Pose(0.0, 0.0, 0.0)) for _ in range(80)),
)


@pytest.mark.parametrize(
    ("task", "variant"), ENVIRONMENTS, ids=lambda value: getattr(value, "name", value)
)
def test_sampled_scenes_keep_the_rules(task: Task, variant: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(SCENES):
        check_placement(task, variant, task.sample(variant, rng)[0])


@pytest.fixture
def few_attempts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few proposals, few restarts."""
    monkeypatch.setattr(placement, "MAX_PROPOSALS", 50)
    monkeypatch.setattr(placement, "MAX_RESTARTS", 3)


@pytest.mark.usefixtures("few_attempts")
def test_no_room_is_a_named_error_after_a_bounded_number_of_attempts() -> None:
    rng = np.random.default_rng(0)
    before = repr(CROWDED)
    with pytest.raises(PlacementError) as error:
        sample_placement(CROWDED, Axis.LAYOUT, rng, Placement())
    assert "found no room for block" in str(error.value)
    assert "(red circle) in 50 proposals, in the last of 3 attempts" in str(error.value)
    assert "use fewer blocks" in str(error.value)
    assert repr(CROWDED) == before


@pytest.mark.usefixtures("few_attempts")
@pytest.mark.parametrize(("side", "count", "what"), [(0.9, 4, "region 1"), (1.99, 1, "the robot")])
def test_no_room_for_regions_or_robot(side: float, count: int, what: str) -> None:
    regions = (Region(Colour.RED, -1 + 0.001, 1 - 0.001, side, side),) * count
    scene, rng = Scene(Pose(0.0, 0.0, 0.0), regions=regions), np.random.default_rng(0)
    with pytest.raises(PlacementError, match=f"no room for {what}"):
        sample_placement(scene, Axis.JITTER, rng, Placement(region_size=(0.0, 2.0)))


def test_a_scene_without_room_is_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve blocks seldom all find room in eight proposals each, but some attempt succeeds."""
    monkeypatch.setattr(placement, "MAX_PROPOSALS", 8)
    monkeypatch.setattr(placement, "MAX_RESTARTS", 10_000)
    attempts = 0
    attempt = placement._attempt

    def counted(*arguments: object) -> Scene:
        nonlocal attempts
        attempts += 1
        return attempt(*arguments)

    monkeypatch.setattr(placement, "_attempt", counted)
    scene = replace(CROWDED, blocks=CROWDED.blocks[:12])
    placed = sample_placement(scene, Axis.LAYOUT, np.random.default_rng(0), Placement())
    assert len(placed.blocks) == 12
    assert attempts > 1


def test_without_jitter_or_layout_nothing_is_sampled() -> None:
    rng = np.random.default_rng(0)
    assert sample_placement(CROWDED, Axis.COLOUR, rng, Placement()) is CROWDED
    assert rng.random() == np.random.default_rng(0).random()


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
def test_the_check_rejects(task: Task, variant: str, scene: Scene, change: dict[str, Any]) -> None:
    check_placement(task, variant, scene)
    with pytest.raises(InvalidSceneError):
        check_placement(task, variant, replace(scene, **change))
