"""Comparison of the physics with recorded motions."""

import copy
import json
import math
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


def test_results_of_another_shape_are_refused(recorded: dict[str, Any], tmp_path: Path) -> None:
    motion = recorded["push_two_square"]
    one_for_all = {**motion, "block_poses": np.array(motion["block_poses"])[:, 0].tolist()}
    (tmp_path / "motions.json").write_text(json.dumps({"push": one_for_all}))
    with pytest.raises(RecordingError, match="push: block_poses not of shape"):
        motions.load(tmp_path / "motions.json")
