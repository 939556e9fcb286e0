"""Scenes and dynamics as data: exact in both directions, and checked where they are made."""

import json
from typing import Any

import numpy as np
import pytest

from magical.errors import InvalidSceneError, MagicalError
from magical.scene import Block, Colour, Dynamics, Pose, Region, Scene, Shape
from magical.tasks import TASKS


@pytest.mark.parametrize("task", TASKS)
def test_a_scene_is_the_same_after_its_way_through_json(task: str) -> None:
    demo = TASKS[task].demo
    assert Scene.from_dict(json.loads(json.dumps(demo.to_dict()))) == demo


def test_regions_by_their_centre_as_in_the_recordings() -> None:
    data = {"robot": [0, 0, 0], "regions": [["red", 0.25, 0.25, 0.5, 1.0]]}
    assert Scene.from_dict(data).regions == (Region(Colour.RED, -0.25, 0.5, 0.5, 1.0),)


def test_numbers_of_numpy_become_floats() -> None:
    values: Any = [np.float16(0.25), np.float32(0.5), np.float64(1), np.int64(1), np.uint8(2)]
    scene = Scene(
        Pose(*values[:3]),
        (Block(Shape.STAR, Colour.RED, Pose(*values[2:])),),
        (Region(Colour.RED, *values[1:]),),
    )
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
    dynamics = Dynamics(*values)
    assert Dynamics.from_dict(json.loads(json.dumps(dynamics.to_dict()))) == dynamics


ROBOTS: tuple[Any, ...] = (
    *(5, None, "abc", [0, 0]),
    *([0, 0, float("nan")], [0, 0, 10**400], [0, 0, "0"], [0, 0, None], [0, 0, [0]]),
    *([1e308, 0, 0], [0, 0, -1e308], [0, -1000.5, 0]),
)
BLOCKS: tuple[Any, ...] = (
    *(5, None, [5], [[]], [["star", "red"]]),
    *([["cube", "red", 0, 0, 0]], [[[], "red", 0, 0, 0]], [[{}, "red", 0, 0, 0]]),
    *([["star", "red", 0, -1e308, 0]], [["star", "red", 0, 0, 0]] * 101),
)
REGIONS: tuple[Any, ...] = (
    *(5, [5], [["red"]], [{"colour": "red"}], [["pink", 0, 0, 1, 1]]),
    *([["red", 0, 0, 1, 0]], [["red", 0, 0, 1, "1"]], [["red", 0, 0, 1, 10**400]]),
    *([["red", -1e9, 0, 1, 1]], [["red", 0, 0, 1, 1e308]], [["red", 0, 0, 1, 1]] * 31),
)
WRONG_SCENES: tuple[Any, ...] = (
    *(5, None, [], {}),
    *({"robot": robot} for robot in ROBOTS),
    *({"robot": [0, 0, 0], "blocks": blocks} for blocks in BLOCKS),
    *({"robot": [0, 0, 0], "regions": regions} for regions in REGIONS),
    *({"robot": [0, 0, 0], "goal_regions": []}, {"robot": [0, 0, 0], "robot_first": "false"}),
)
WRONG_DYNAMICS: tuple[Any, ...] = (
    *(5, None, "abcde", [1, 2, 3], [1] * 6, [1, 1, 1, 1, "1"], [1, 1, 1, 1, 10**400]),
    *({"gravity": 1.0}, {3: 1.0}, {"body_gear_max_force": -1}, {"body_gear_max_force": None}),
)


@pytest.mark.parametrize("data", WRONG_SCENES, ids=lambda data: repr(data)[:60])
def test_what_is_no_scene(data: Any) -> None:
    with pytest.raises(MagicalError, match="expected") as caught:
        Scene.from_dict(data)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("data", WRONG_DYNAMICS, ids=lambda data: repr(data)[:60])
def test_what_are_no_dynamics(data: Any) -> None:
    with pytest.raises(InvalidSceneError, match=r"dynamics.*: expected"):
        Dynamics.from_dict(data)
