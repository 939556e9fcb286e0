"""The recordings in the package: `magical conformance` checks them all, and notices damage."""

import gzip
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from magical import cli
from magical.conformance import motions, scenes, scores
from magical.conformance.recordings import DATA, RECORDINGS
from magical.errors import RecordingError
from magical.evaluation import published_tasks
from magical.tasks import TASKS

Run = Callable[..., tuple[int, list[str], dict[str, Any]]]
FILES = [(kind, name) for kind, names in RECORDINGS.items() for name in names]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs the command; returns its exit status, the lines it printed, and its JSON."""

    def call(*arguments: object) -> tuple[int, list[str], dict[str, Any]]:
        status = cli.main(["conformance", *map(str, arguments), "--json"])
        *lines, last = capsys.readouterr().out.splitlines()
        return status, lines, json.loads(last)

    return call


def test_without_arguments_everything_in_the_package_is_checked(run: Run) -> None:
    status, lines, result = run()
    assert status == 0
    assert [(each["kind"], each["file"]) for each in result["recordings"]] == FILES
    assert set(result) == {"passed", "recordings"}
    assert [each["file"] for each in result["recordings"] if not each["passed"]] == []
    for kind, name in FILES:
        assert f"{name} ({kind})" in lines
    compared = {
        each["file"]: {line["name"] for line in each["lines"]} for each in result["recordings"]
    }
    assert compared["scenes.json.gz"] == compared["scores.json.gz"] == set(published_tasks())
    assert {"drive position", "grip position"} < compared["motions.json"]
    assert {"MakeLine ego", "worst allo frame"} < compared["frames-384.npz"]


def test_a_kind_alone_is_checked_against_its_files(run: Run) -> None:
    status, lines, result = run("motions")
    assert (status, result["kind"], result["file"]) == (0, "motions", "motions.json")
    assert len(result["lines"]) == len(lines) - 2  # header and rule
    assert result["recordings"] == [
        {key: result[key] for key in ("kind", "file", "passed", "lines")}
    ]


def test_a_limit_missed_in_one_recording_fails(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical.conformance.motions.GRIP_LIMIT", 0.01)
    monkeypatch.setitem(RECORDINGS, "frames", ())
    monkeypatch.setitem(RECORDINGS, "scenes", ())
    status, _, result = run()
    assert (status, result["passed"]) == (1, False)
    assert {each["kind"]: each["passed"] for each in result["recordings"]} == {
        "motions": False,
        "scores": True,
    }


@pytest.mark.parametrize("arguments", [[], ["frames"]])
def test_out_needs_a_single_recording(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert cli.main(["conformance", *arguments, "--out", str(out)]) == 2
    assert "expected a single recording, found frames-96.npz" in capsys.readouterr().err
    assert not out.exists()


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
