"""The recordings: `python -m tests.reference` checks them all, and notices damage."""

import gzip
import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from magical.evaluation import published_tasks
from magical.tasks import TASKS
from tests.reference import motions, scenes, scores
from tests.reference.__main__ import main
from tests.reference.recordings import DATA, RECORDINGS, RecordingError

FILES = [(kind, name) for kind, names in RECORDINGS.items() for name in names]


def test_without_arguments_every_recording_is_checked(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    titles = [f"{name} ({kind})" for kind, name in FILES]
    assert [line for line in lines if line in titles] == titles
    compared: dict[str, set[str]] = {}
    for line in lines:
        if line in titles:
            names = compared.setdefault(line.split()[0], set())
        elif line.startswith("ok "):
            names.add(re.split(r"  +", line)[1])
    assert compared["scenes.json.gz"] == compared["scores.json.gz"] == set(published_tasks())
    assert {"drive position", "grip position"} < compared["motions.json"]
    assert {"MakeLine ego", "worst allo frame"} < compared["frames-384.npz"]
    assert "MISSED" not in "".join(lines)


def test_a_limit_missed_in_one_recording_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tests.reference.motions.GRIP_LIMIT", 0.01)
    monkeypatch.setitem(RECORDINGS, "frames", ())
    monkeypatch.setitem(RECORDINGS, "scenes", ())
    assert main([]) == 1
    motions_table, scores_table = capsys.readouterr().out.split("scores.json.gz (scores)")
    assert "MISSED" in motions_table
    assert "MISSED" not in scores_table


def test_a_file_without_results_is_computed_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = tmp_path / "motions.json", tmp_path / "out.json"
    motion = {"robot": [[0.0, 0.0], 0.0], "blocks": [], "actions": [0]}
    data.write_text(json.dumps({"drive-still": motion}))
    assert main(["motions", str(data), str(out)]) == 0
    assert len(json.loads(out.read_text())["drive-still"]["robot_pose"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "nothing compared" in captured.err
    assert main(["motions", str(tmp_path / "missing")]) == 1
    assert "missing" in capsys.readouterr().err


def test_every_data_file_has_its_sum_and_its_kind() -> None:
    names = sorted(name for _, name in FILES)
    sums = [line.split() for line in (DATA / "SHA256SUMS").read_text().splitlines()]
    assert sums == [[hashlib.sha256((DATA / n).read_bytes()).hexdigest(), n] for n in names]
    data = {path.name for path in DATA.iterdir()} - {"README.md", "SHA256SUMS"}
    assert sorted(data) == names
    readme = (DATA / "README.md").read_text()
    assert [name for name in names if f"| `{name}` |" not in readme] == []


MOTION = {"robot": [[0, 0], 0], "blocks": [], "actions": [1]}
FLAT = {"robot_pose": [[0, 0]] * 2, "finger_angles": [[0, 0]] * 2, "block_poses": [[]] * 2}
CORNER = TASKS["MoveToCorner"].demo.to_dict()
STATE = {"task": "MoveToCorner", "scene": CORNER, "final": CORNER}
ROW = {"robot": [0, 0, 0], "blocks": [], "regions": [], "dynamics": [3, 1, 4, 1.5, 0.1]}
LINE = "MakeLine-Demo-v0"


def without(data: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key != name}


@pytest.mark.parametrize(
    ("load", "contents"),
    [
        (motions.load, []),
        (motions.load, {"a": without(MOTION, "actions")}),
        (motions.load, {"a": MOTION | {"actions": [18]}}),
        (motions.load, {"a": MOTION | {"robot": [[0], 0]}}),
        (motions.load, {"a": MOTION | {"blocks": [["cube", [0, 0], 0]]}}),
        (motions.load, {"a": MOTION | {"robot_pose": []}}),
        (motions.load, {"a": MOTION | {"actions": [1.0]}}),
        (motions.load, {"a": MOTION | FLAT}),
        (scores.load, {}),
        (scores.load, [3]),
        (scores.load, [without(STATE, "final")]),
        (scores.load, [STATE | {"task": "MoveToMoon"}]),
        (scores.load, [STATE | {"final": {"robot": [0, 0, 0], "blocks": []}}]),
        (scores.load, [STATE | {"scene": {"robot": [0, 0, 0]}}]),
        (scores.load, [STATE | {"score": "high"}]),
        (scenes.load, 3),
        (scenes.load, {"MoveToMoon-Demo-v0": []}),
        (scenes.load, {"MoveToCorner-TestLayout-v0": []}),
        (scenes.load, {"MakeLine-Demo": []}),
        (scenes.load, {LINE: [3]}),
        (scenes.load, {LINE: [without(ROW, "robot")]}),
        (scenes.load, {LINE: [without(ROW, "dynamics")]}),
        (scenes.load, {LINE: [without(ROW, "regions")]}),
        (scenes.load, {LINE: [ROW | {"blocks": [["cube", "red", 0, 0, 0]]}]}),
    ],
)
def test_a_damaged_file_is_named(
    load: Callable[[Path], object], contents: object, tmp_path: Path
) -> None:
    path = tmp_path / "file.json"
    path.write_text(json.dumps(contents))
    with pytest.raises(RecordingError, match=r"file\.json: expected JSON"):
        load(path)


@pytest.mark.parametrize("load", [motions.load, scores.load, scenes.load])
def test_a_truncated_or_corrupt_file_is_named(
    load: Callable[[Path], object], tmp_path: Path
) -> None:
    path = tmp_path / "file.json.gz"
    whole = gzip.compress(json.dumps([STATE]).encode())
    for damaged in (whole[:-20], whole[:20] + b"\xff\xff" + whole[22:], b"", b"\xff\xfe", b"{"):
        path.write_bytes(damaged)
        with pytest.raises(RecordingError, match=r"file\.json\.gz: expected JSON"):
            load(path)
    with pytest.raises(RecordingError, match="cannot be read"):
        load(tmp_path / "missing.json")
