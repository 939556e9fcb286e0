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


ORIGIN, TOO_LARGE = [0, 0, 0], [["star", "red", 0, -1e308, 0]]
WRONG_SCENES: tuple[Any, ...] = (
    *(5, None, [], {}, {"robot": ORIGIN, "goal_regions": []}),
    *({"robot": robot} for robot in (5, "abc", [0, 0], [0, 0, float("nan")], [0, 0, "0"])),
    *({"robot": robot} for robot in ([0, 0, 10**400], [0, 0, [0]], [0, -1000.5, 0])),
    *({"robot": ORIGIN, "blocks": blocks} for blocks in (5, [5], [["star", "red"]], TOO_LARGE)),
    *({"robot": ORIGIN, "blocks": [[shape, "red", *ORIGIN]]} for shape in ("cube", [], {})),
    *({"robot": ORIGIN, "regions": regions} for regions in (5, [["red"]], [{"colour": "red"}])),
    *({"robot": ORIGIN, "regions": [["red", 0, 0, 1, width]]} for width in (0, "1", 1e308)),
    {"robot": ORIGIN, "blocks": [["star", "red", *ORIGIN]] * 101},
    {"robot": ORIGIN, "regions": [["red", 0, 0, 1, 1]] * 31},
    {"robot": ORIGIN, "regions": [["pink", 0, 0, 1, 1]]},
    {"robot": ORIGIN, "robot_first": "false"},
)
WRONG_DYNAMICS: tuple[Any, ...] = (
    *(5, None, [1, 2, 3], {"gravity": 1.0}, {3: 1.0}),
    *({"body_gear_max_force": force} for force in (-1, None, "1", 10**400)),
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
