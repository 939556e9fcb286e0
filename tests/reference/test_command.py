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
from magical.scene import View
from magical.tasks import TASKS
from tests.reference import motions, scenes, scores
from tests.reference.__main__ import main
from tests.reference.recordings import DATA, RECORDINGS, RecordingError

FILES = [(kind, name) for kind, names in RECORDINGS.items() for name in names]
PARTS = ("first steps", "position", "robot angle")
MOTIONS = {f"{kind} {part}" for kind in ("drive", "turn", "push", "grip") for part in PARTS}
FRAMES = {f"{task} {view}" for task in published_tasks() for view in View}
COMPARED = {
    "frames": FRAMES | {"worst ego frame", "worst allo frame"},
    "motions": MOTIONS | {"push block angle", "grip block angle"},
    "scenes": set(published_tasks()),
    "scores": set(published_tasks()),
}
ROUNDING = 0.01  # of 255: single samples of a frame on an edge, which rounding puts on either side


@pytest.mark.parametrize(("kind", "name"), FILES)
def test_every_recording_is_within_its_limits(
    kind: str, name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenes, "SAMPLES", 400)
    assert main([kind, str(DATA / name)]) == 0
    title, _, _, *rows = capsys.readouterr().out.splitlines()
    assert title == f"{name} ({kind})"
    figures = {row[1]: float(row[2]) for row in (re.split(r"  +", line) for line in rows)}
    assert figures.keys() == COMPARED[kind]
    assert kind != "frames" or max(figures.values()) < ROUNDING


def test_a_limit_missed_in_one_recording_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tests.reference.motions.GRIP_LIMIT", 0.01)
    for kind in ("frames", "scenes"):
        monkeypatch.setitem(RECORDINGS, kind, ())
    assert main([]) == 1
    motions_table, scores_table = capsys.readouterr().out.split("scores.json.gz (scores)")
    assert "MISSED" in motions_table
    assert "MISSED" not in scores_table


MOTION = {"robot": [[0.0, 0.0], 0.0], "blocks": [], "actions": [0]}
CORNER = TASKS["MoveToCorner"].demo.to_dict()
FINAL = {**CORNER, "blocks": [["square", "red", -0.8, 0.8, 0.0]]}
STATE = {"task": "MoveToCorner", "scene": CORNER, "final": FINAL}
ROW = {"robot": [0, 0, 0], "blocks": [], "regions": [], "dynamics": [3, 1, 4, 1.5, 0.1]}
ENTERED: dict[str, Any] = {
    "motions": {"drive-still": MOTION},
    "scores": [STATE, STATE],
    "scenes": ["MakeLine-Demo-v0"],
}


@pytest.mark.parametrize("kind", ENTERED)
def test_a_file_without_results_is_computed_and_written(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = tmp_path / "data.json", tmp_path / "out.json"
    data.write_text(json.dumps(ENTERED[kind]))
    assert main([kind, str(data), str(out)]) == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "nothing compared" in captured.err
    written = json.loads(out.read_text())
    if kind == "motions":
        assert len(written["drive-still"]["robot_pose"]) == 2
    elif kind == "scores":
        assert written == [{"score": 1.0, "published_code_score": 1.0}] * 2
    else:
        assert written["MakeLine-Demo-v0"][0].keys() == ROW.keys()
    assert main([kind, str(tmp_path / "missing")]) == 1
    assert "missing: cannot be read" in capsys.readouterr().err


def test_every_data_file_has_its_sum_and_its_kind() -> None:
    names = sorted(name for _, name in FILES)
    sums = [line.split() for line in (DATA / "SHA256SUMS").read_text().splitlines()]
    assert sums == [[hashlib.sha256((DATA / n).read_bytes()).hexdigest(), n] for n in names]
    data = {path.name for path in DATA.iterdir()} - {"README.md", "SHA256SUMS"}
    assert sorted(data) == names
    readme = (DATA / "README.md").read_text()
    assert [name for name in names if f"| `{name}` |" not in readme] == []


@pytest.mark.parametrize(
    ("load", "contents"),
    [
        (motions.load, []),
        (motions.load, {"a": MOTION | {"actions": [18]}}),
        (motions.load, {"a": MOTION | {"blocks": [["cube", [0, 0], 0]]}}),
        (motions.load, {"a": MOTION | {"robot_pose": [[0, 0]] * 2}}),
        (scores.load, [3]),
        (scores.load, [STATE | {"task": "MoveToMoon"}]),
        (scores.load, [STATE | {"final": {"robot": [0, 0, 0], "blocks": []}}]),
        (scores.load, [STATE | {"score": "high"}]),
        (scenes.load, {"MoveToCorner-TestLayout-v0": []}),
        (scenes.load, {"MakeLine-Demo-v0": [ROW | {"blocks": [["cube", "red", 0, 0, 0]]}]}),
    ],
)
def test_a_damaged_file_is_named(
    load: Callable[[Path], object], contents: object, tmp_path: Path
) -> None:
    path = tmp_path / "file.json"
    path.write_text(json.dumps(contents))
    with pytest.raises(RecordingError, match=r"file\.json: expected JSON"):
        load(path)


def test_a_truncated_or_corrupt_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "file.json.gz"
    whole = gzip.compress(json.dumps([STATE]).encode())
    for damaged in (whole[:-20], whole[:20] + b"\xff\xff" + whole[22:], b"", b"\xff\xfe", b"{"):
        path.write_bytes(damaged)
        with pytest.raises(RecordingError, match=r"file\.json\.gz: expected JSON"):
            scores.load(path)
