"""Invalid scenes and their messages."""

from dataclasses import replace

import pytest

from magical.errors import InvalidSceneError
from magical.scene import Block, Colour, Pose, Region, Scene, Shape
from magical.tasks import TASKS, validate_scene

EMPTY = Scene(Pose(0.0, 0.0, 0.0))


def circles(*places: tuple[float, float]) -> tuple[Block, ...]:
    return tuple(Block(Shape.CIRCLE, Colour.RED, Pose(x, y, 0.0)) for x, y in places)


@pytest.mark.parametrize("name", TASKS)
def test_demo_scenes_are_valid(name: str) -> None:
    validate_scene(TASKS[name].demo)


def test_overlapping_blocks_are_named_with_how_much() -> None:
    scene = replace(EMPTY, blocks=circles((0.7, 0.7), (0.7, -0.7), (0.7, -0.5)))
    with pytest.raises(InvalidSceneError) as error:
        validate_scene(scene)
    assert str(error.value) == (
        "scene: block 1 (red circle) and block 2 (red circle) overlap by 0.040 units, "
        "expected at most 0.01; move them apart"
    )


@pytest.mark.parametrize(("distance", "valid"), [(0.2301, True), (0.2299, False)])
def test_blocks_may_overlap_by_the_collision_slop(distance: float, valid: bool) -> None:
    scene = replace(EMPTY, blocks=circles((0.7, 0.0), (0.7, distance)))
    if valid:
        validate_scene(scene)
    else:
        with pytest.raises(InvalidSceneError, match=r"overlap by 0\.010 units"):
            validate_scene(scene)


def test_a_block_under_the_robot_or_a_finger() -> None:
    with pytest.raises(InvalidSceneError, match=r"the robot and block 0 \(red circle\) overlap"):
        validate_scene(replace(EMPTY, blocks=circles((0.1, -0.2))))
    with pytest.raises(InvalidSceneError, match=r"the robot and block 0 \(red circle\) overlap"):
        validate_scene(replace(EMPTY, blocks=circles((0.2, 0.3))))  # the right finger
    validate_scene(replace(EMPTY, blocks=circles((0.4, 0.4))))


@pytest.mark.parametrize(("x", "valid"), [(0.899, True), (0.901, False)])
def test_bodies_may_reach_into_walls_by_the_slack(x: float, valid: bool) -> None:
    scene = replace(EMPTY, blocks=circles((x, 0.0)))
    if valid:
        validate_scene(scene)
    else:
        with pytest.raises(InvalidSceneError, match=r"\(0.901, 0\) reaches 0.021 units outside"):
            validate_scene(scene)


def test_robot_outside() -> None:
    with pytest.raises(InvalidSceneError, match=r"the robot at .* outside the workspace"):
        validate_scene(Scene(Pose(0.9, 0.0, 0.0)))
    with pytest.raises(InvalidSceneError, match=r"the robot at .* outside the workspace"):
        validate_scene(Scene(Pose(0.0, 0.75, 0.0)))  # its fingers


def test_region_outside() -> None:
    region = Region(Colour.BLUE, x=0.5, y=0.0, height=0.5, width=0.6)
    with pytest.raises(InvalidSceneError, match=r"region 0 \(blue\) .* 0.1 units outside"):
        validate_scene(replace(EMPTY, regions=(region,)))
    validate_scene(replace(EMPTY, regions=(replace(region, width=0.5),)))


def test_bodies_may_be_in_regions() -> None:
    region = Region(Colour.BLUE, x=-0.5, y=0.5, height=1.0, width=1.0)
    validate_scene(replace(EMPTY, regions=(region, region), blocks=circles((0.4, -0.4))))
