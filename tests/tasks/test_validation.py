"""Invalid scenes and their messages."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical.errors import InvalidSceneError
from magical.scene import SHAPES, Block, Colour, Pose, Region, Scene, Shape
from magical.tasks import validate_scene

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
    "blocks": (circles((0.7, 0.0), (0.7, 0.2299)), r"overlap by 0\.010 units"),
    "robot": (circles((0.1, -0.2)), r"the robot and block 0 \(red circle\) overlap"),
    "finger": (circles((0.2, 0.3)), r"the robot and block 0 \(red circle\) overlap"),
    "wall": (circles((0.901, 0.0)), r"\(0.901, 0\) reaches 0.021 units outside"),
    "robot in a wall": ({"robot": Pose(0.9, 0, 0)}, "the robot at .* outside the workspace"),
    "fingers in a wall": ({"robot": Pose(0, 0.75, 0)}, "the robot at .* outside the workspace"),
    "region": (
        {"regions": (replace(RIGHT, width=0.6),)},
        r"region 0 \(blue\) .* 0.1 units outside",
    ),
}


@pytest.mark.parametrize("fields", VALID.values(), ids=VALID)
def test_what_is_valid(fields: dict[str, Any]) -> None:
    validate_scene(replace(EMPTY, **fields))


@pytest.mark.parametrize(("fields", "message"), INVALID.values(), ids=INVALID)
def test_what_is_invalid(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSceneError, match=message):
        validate_scene(replace(EMPTY, **fields))


def test_overlapping_blocks_are_named_with_how_much() -> None:
    scene = replace(EMPTY, **circles((0.7, 0.7), (0.7, -0.7), (0.7, -0.5)))
    with pytest.raises(InvalidSceneError) as error:
        validate_scene(scene)
    assert str(error.value) == (
        "scene: block 1 (red circle) and block 2 (red circle) overlap by 0.040 units, "
        "expected at most 0.01; move them apart"
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_blocks_at_one_pose_overlap(shape: Shape) -> None:
    """Their corners coincide, so the line between two corners has no direction."""
    rng = np.random.default_rng(0)
    for x, y, angle in rng.uniform((-0.7, -0.7, -np.pi), (0.7, -0.4, np.pi), (100, 3)):
        block = Block(shape, Colour.RED, Pose(x, y, angle))
        with pytest.raises(InvalidSceneError, match=r"block 0 .* and block 1 .* overlap"):
            validate_scene(replace(EMPTY, blocks=(block, block)))
