"""Comparison of the physics with recorded motions."""

import copy
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.reference import motions
from tests.reference.recordings import DATA, RecordingError


@pytest.fixture(scope="module")
def recorded() -> dict[str, Any]:
    return motions.load(DATA / "motions.json")


@pytest.fixture(scope="module")
def computed(recorded: dict[str, Any]) -> dict[str, Any]:
    return motions.compute(recorded)


def test_within_limits(recorded: dict[str, Any], computed: dict[str, Any]) -> None:
    comparisons = motions.compare(recorded, computed)
    assert {each.name for each in comparisons} == {
        "drive first steps", "drive position", "drive robot angle",
        "turn first steps", "turn position", "turn robot angle",
        "push first steps", "push position", "push robot angle", "push block angle",
        "grip first steps", "grip position", "grip robot angle", "grip block angle",
    }  # fmt: skip
    assert [each for each in comparisons if not each.passed] == []


def test_fingers_follow_the_recordings_where_nothing_is_touched(
    recorded: dict[str, Any], computed: dict[str, Any]
) -> None:
    for name in ("close_open", "turn_left", "turn_right"):
        difference = np.subtract(computed[name]["finger_angles"], recorded[name]["finger_angles"])
        assert np.abs(difference).max() < 0.01, name


@pytest.mark.parametrize(
    ("recorded", "meant"),
    [(0.0, 0.0), (-1.5707963, -math.pi / 2), (3.1415927, math.pi), (1.57, 1.57), (0.3, 0.3)],
)
def test_rounded_quarter_turns_are_restored(recorded: float, meant: float) -> None:
    motion = {"robot": [[0.1, 0.2], recorded], "blocks": [], "actions": []}
    (row,) = motions.compute({"still": motion})["still"]["robot_pose"]
    assert row == [0.1, 0.2, meant]


def test_a_wrong_motion_is_detected(recorded: dict[str, Any], computed: dict[str, Any]) -> None:
    wrong = copy.deepcopy(recorded)
    wrong["push_star"]["block_poses"][-1][0][0] += 0.1
    wrong["push_circle"]["block_poses"][-1][0][2] += 0.01
    wrong["turn_left"]["robot_pose"][4][2] += 0.05
    wrong["drive_back"]["finger_angles"][2][0] += 1e-6
    failed = {each.name for each in motions.compare(wrong, computed) if not each.passed}
    assert failed == {
        "push position", "push block angle", "turn robot angle", "drive first steps",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("block_poses", lambda poses: poses[:, 0]),  # one block's for all
        ("finger_angles", lambda angles: angles[:, :1]),
        ("robot_pose", lambda poses: poses[1:]),
    ],
)
def test_results_of_other_shapes_are_refused(
    recorded: dict[str, Any], key: str, change: Callable[[Any], Any], tmp_path: Path
) -> None:
    motion = recorded["push_two_square"]
    changed = {**motion, key: change(np.array(motion[key])).tolist()}
    (tmp_path / "motions.json").write_text(json.dumps({"push": changed}))
    with pytest.raises(RecordingError, match=f"push: {key} not of shape"):
        motions.load(tmp_path / "motions.json")


def test_without_recorded_results_it_only_computes(
    recorded: dict[str, Any], computed: dict[str, Any], tmp_path: Path
) -> None:
    inputs = {
        name: {key: motion[key] for key in ("robot", "blocks", "actions")}
        for name, motion in recorded.items()
    }
    (tmp_path / "inputs.json").write_text(json.dumps(inputs))
    data = motions.load(tmp_path / "inputs.json")
    results = motions.compute(data)
    assert motions.compare(data, results) == []
    motions.write(results, tmp_path / "out.json")
    assert json.loads((tmp_path / "out.json").read_text()) == computed
