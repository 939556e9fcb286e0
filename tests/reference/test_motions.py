"""The physics against recorded motions."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.conformance import motions
from magical.errors import RecordingError


@pytest.fixture(scope="module")
def recorded(shared: Path) -> dict[str, Any]:
    return motions.load(shared / "reference" / "motions.json")


@pytest.fixture(scope="module")
def computed(recorded: dict[str, Any]) -> dict[str, Any]:
    return motions.compute(recorded)


def test_within_limits(recorded: dict[str, Any], computed: dict[str, Any]) -> None:
    lines = motions.compare(recorded, computed)
    assert {line.name for line in lines} == {
        "drive position", "drive robot angle", "turn position", "turn robot angle",
        "push position", "push robot angle", "grip position",
    }  # fmt: skip
    assert [line for line in lines if not line.passed] == []


def test_fingers_follow_the_recordings_where_nothing_is_touched(
    recorded: dict[str, Any], computed: dict[str, Any]
) -> None:
    for name in ("close_open", "turn_left", "turn_right"):
        difference = np.subtract(computed[name]["finger_angles"], recorded[name]["finger_angles"])
        assert np.abs(difference).max() < 0.01, name


def test_a_wrong_recording_is_noticed(recorded: dict[str, Any], computed: dict[str, Any]) -> None:
    wrong = copy.deepcopy(recorded)
    wrong["push_star"]["block_poses"][-1][0][0] += 0.1
    wrong["turn_left"]["robot_pose"][3][2] += 0.05
    failed = {line.name for line in motions.compare(wrong, computed) if not line.passed}
    assert failed == {"push position", "turn robot angle"}


def test_without_answers_it_only_computes(
    recorded: dict[str, Any], computed: dict[str, Any], tmp_path: Path
) -> None:
    asked = {
        name: {key: motion[key] for key in ("robot", "blocks", "actions")}
        for name, motion in recorded.items()
    }
    (tmp_path / "asked.json").write_text(json.dumps(asked))
    data = motions.load(tmp_path / "asked.json")
    answers = motions.compute(data)
    assert motions.compare(data, answers) == []
    motions.write(answers, tmp_path / "out.json")
    assert json.loads((tmp_path / "out.json").read_text()) == computed


@pytest.mark.parametrize(
    "damage",
    [
        "{",
        "[]",
        '{"a": {"robot": [[0, 0], 0], "blocks": []}}',
        '{"a": {"robot": [[0, 0], 0], "blocks": [], "actions": [18]}}',
        '{"a": {"robot": [[0], 0], "blocks": [], "actions": [1]}}',
        '{"a": {"robot": [[0, 0], 0], "blocks": [["cube", [0, 0], 0]], "actions": [1]}}',
        '{"a": {"robot": [[0, 0], 0], "blocks": [], "actions": [1], "robot_pose": []}}',
    ],
)
def test_damaged_files(damage: str, tmp_path: Path) -> None:
    path = tmp_path / "motions.json"
    path.write_text(damage)
    with pytest.raises(RecordingError, match=r"motions\.json"):
        motions.load(path)
