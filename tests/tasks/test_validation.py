"""Scenes that cannot be simulated or do not fit a task, tasks that contradict themselves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical.errors import InvalidSceneError, InvalidTaskError
from magical.scene import SHAPES, Block, Colour, Pose, Region, Scene, Shape
from magical.tasks import get_task, validate_scene

EMPTY = Scene(Pose(0.0, 0.0, 0.0))
REGION = Region(Colour.BLUE, x=-0.5, y=0.5, height=1.0, width=1.0)
RIGHT = Region(Colour.BLUE, x=0.5, y=0.0, height=0.5, width=0.5)


def circles(*places: tuple[float, float]) -> dict[str, Any]:
    return {"blocks": tuple(Block(Shape.CIRCLE, Colour.RED, Pose(x, y, 0.0)) for x, y in places)}


VALID: dict[str, dict[str, Any]] = {
    "blocks overlap by the collision slop": circles((0.7, 0.0), (0.7, 0.2301)),
    "a block beside a finger": circles((0.4, 0.4)),
    "a body reaches into a wall by the slack": circles((0.899, 0.0)),
    "a region at the wall": {"regions": (RIGHT,)},
    "bodies and regions in regions": {"regions": (REGION, REGION), **circles((0.4, -0.4))},
}
INVALID: dict[str, tuple[dict[str, Any], str]] = {
    "blocks": (
        circles((0.7, 0.7), (0.7, -0.7), (0.7, -0.5)),
        r"^scene: block 1 \(red circle\) and block 2 \(red circle\) overlap by 0.040 units, "
        r"expected at most 0.01; move them apart$",
    ),
    "slop": (circles((0.7, 0.0), (0.7, 0.2299)), r"overlap by 0\.010 units"),
    "robot": (circles((0.1, -0.2)), r"the robot and block 0 \(red circle\) overlap"),
    "finger": (circles((0.2, 0.3)), r"the robot and block 0 \(red circle\) overlap"),
    "wall": (circles((0.901, 0.0)), r"\(0.901, 0\) reaches 0.021 units outside"),
    "robot in a wall": ({"robot": Pose(0.9, 0, 0)}, "the robot at .* outside the workspace"),
    "fingers in a wall": ({"robot": Pose(0, 0.75, 0)}, "the robot at .* outside the workspace"),
    "region": ({"regions": (replace(RIGHT, width=0.6),)}, r"region 0 \(blue\) .* 0.1 units outsi"),
}


@pytest.mark.parametrize("fields", VALID.values(), ids=VALID)
def test_what_is_valid(fields: dict[str, Any]) -> None:
    validate_scene(replace(EMPTY, **fields))


@pytest.mark.parametrize(("fields", "message"), INVALID.values(), ids=INVALID)
def test_what_is_invalid(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSceneError, match=message):
        validate_scene(replace(EMPTY, **fields))


@pytest.mark.parametrize("shape", SHAPES)
def test_blocks_at_one_pose_overlap(shape: Shape) -> None:
    """Their corners coincide, so the line between two corners has no direction."""
    rng = np.random.default_rng(0)
    for x, y, angle in rng.uniform((-0.7, -0.7, -np.pi), (0.7, -0.4, np.pi), (100, 3)):
        block = Block(shape, Colour.RED, Pose(x, y, angle))
        with pytest.raises(InvalidSceneError, match=r"block 0 .* and block 1 .* overlap"):
            validate_scene(replace(EMPTY, blocks=(block, block)))


FIND, FIX = get_task("FindDupe").demo.blocks, get_task("FixColour").demo
AROUND = replace(FIX.regions[1], y=0.1, height=1.0)  # the first block, too
MISFITS: list[tuple[str, dict[str, Any], str]] = [
    ("MoveToCorner", {"blocks": ()}, "at least 1 blocks, found 0"),
    ("MoveToRegion", {"regions": ()}, "at least 1 regions"),
    ("MoveToRegion", circles((0.4, -0.4)), "at most 0 blocks, found 1"),
    ("MakeLine", circles((0.4, -0.4)), "at least 2 blocks"),
    ("MatchRegions", {"regions": ()}, "at least 1 regions"),
    (
        *("MatchRegions", {"regions": (replace(RIGHT, colour=Colour.RED),)}),
        "block of the region's colour red",
    ),
    ("FindDupe", {"regions": ()}, "at least 1 regions"),
    ("FindDupe", {"blocks": (*FIND[:-2], FIND[-1])}, "expected a duplicate"),
    (
        *("FindDupe", {"blocks": (*FIND[:-1], replace(FIND[-1], pose=Pose(0.2, 0.0, 0.0)))}),
        r"block 6 alone inside its region, found blocks \[\]",
    ),
    (
        *("FindDupe", {"blocks": (replace(FIND[0], pose=Pose(-0.57, -0.72, 0.0)), *FIND[1:])}),
        r"block 6 alone inside its region, found blocks \[0, 6\]",
    ),
    ("FixColour", {"regions": FIX.regions[:2]}, "a region for every block"),
    (
        *("FixColour", {"blocks": FIX.blocks[:2], "regions": FIX.regions[:2]}),
        "exactly 1 block of another colour",
    ),
    (
        *("FixColour", {"regions": (FIX.regions[0], AROUND, FIX.regions[2])}),
        r"block 1 alone inside its region, found blocks \[0, 1\]",
    ),
]


@pytest.mark.parametrize(("name", "change", "message"), MISFITS)
def test_scenes_that_do_not_fit(name: str, change: dict[str, Any], message: str) -> None:
    task = get_task(name)
    with pytest.raises(InvalidSceneError, match=f"{name}: .*{message}"):
        task.validate(replace(task.demo, **change))


@pytest.mark.parametrize("name", ["ClusterColour", "ClusterShape"])
def test_clusters_need_all_four_values(name: str) -> None:
    task, attribute = get_task(name), name.removeprefix("Cluster").lower()
    blocks = task.demo.blocks
    value = getattr(blocks[0], attribute)
    left = tuple(b for b in blocks if getattr(b, attribute) != value)
    with pytest.raises(InvalidSceneError, match=f"expected at least one {value} block"):
        task.validate(replace(task.demo, blocks=left))


@pytest.mark.parametrize("fields", [{"name": "Move-To"}, {"horizon": 0}])
def test_contradictory_fields_are_rejected(fields: dict[str, Any]) -> None:
    with pytest.raises(InvalidTaskError, match=r"letters and digits.*positive horizon"):
        replace(get_task("MoveToCorner"), **fields)


def test_an_invalid_demo_scene_is_rejected() -> None:
    task = get_task("MoveToCorner")
    with pytest.raises(InvalidSceneError, match="at least 1 blocks"):
        replace(task, demo=replace(task.demo, blocks=()))


def test_a_task_made_from_another_has_one_horizon() -> None:
    task = replace(get_task("MoveToCorner"), horizon=50)
    assert (task.resolve_horizon("published"), task.has_two_horizons) == (50, False)
    cluster = get_task("ClusterShape")
    assert (cluster.horizon, cluster.resolve_horizon("published")) == (320, 240)
