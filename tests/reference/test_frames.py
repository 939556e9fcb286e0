"""The drawing against recorded frames."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.conformance import frames
from magical.errors import RecordingError
from magical.scene import View

EQUAL_ENOUGH = 0.01  # of 255: what is left is where rounding puts single samples


@pytest.fixture(scope="module", params=[96, 384])
def recording(request: pytest.FixtureRequest, shared: Path) -> frames.Recording:
    return frames.load(shared / "reference" / f"frames-{request.param}.npz")


def test_within_limits(recording: frames.Recording) -> None:
    lines = frames.compare(recording, frames.compute(recording))
    assert [line for line in lines if not line.passed] == []
    tasks = {
        "ClusterColour", "ClusterShape", "FindDupe", "FixColour",
        "MakeLine", "MatchRegions", "MoveToCorner", "MoveToRegion",
    }  # fmt: skip
    expected = {f"{task} {view}" for task in tasks for view in View}
    assert {line.name for line in lines} == expected | {"worst ego frame", "worst allo frame"}
    with_regions = {line.name.split()[0] for line in lines if line.limit == frames.REGION_LIMIT}
    assert with_regions == {"FindDupe", "FixColour", "MatchRegions", "MoveToRegion"}
    assert max(line.figure for line in lines) < EQUAL_ENOUGH


def test_a_wrong_drawing_is_noticed(recording: frames.Recording) -> None:
    first = dataclasses.replace(recording, **_only_first(recording))
    drawn = frames.compute(first)
    drawn[View.EGO] = drawn[View.EGO][:, ::-1]
    failed = {line.name for line in frames.compare(first, drawn) if not line.passed}
    assert failed == {f"{first.tasks[0]} ego", "worst ego frame"}


def _only_first(recording: frames.Recording) -> dict[str, Any]:
    cut = {name: getattr(recording, name)[:1] for name in ("scenes", "poses", "tasks", "names")}
    return {**cut, "frames": {view: array[:1] for view, array in recording.frames.items()}}


@pytest.fixture(scope="module")
def records(shared: Path) -> str:
    with np.load(shared / "reference" / "frames-96.npz", allow_pickle=False) as archive:
        return json.dumps(json.loads(str(archive["records"]))[:3])


@pytest.mark.parametrize(("name", "size"), [("asked.npz", 96), ("frames-384.npz", 384)])
def test_without_frames_it_only_computes(
    name: str, size: int, records: str, tmp_path: Path
) -> None:
    np.savez(tmp_path / name, records=np.array(records))
    data = frames.load(tmp_path / name)
    drawn = frames.compute(data)
    assert frames.compare(data, drawn) == []
    frames.write(drawn, tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz", allow_pickle=False) as archive:
        assert set(archive) == {"allo", "ego"}
        for view in View:
            assert archive[view].shape == (3, size, size, 3)
            np.testing.assert_array_equal(archive[view], drawn[view])
    assert frames.load(tmp_path / name, size=40).size == 40


def test_one_view_is_enough(records: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", records=np.array(records), ego=np.zeros((3, 50, 50, 3), np.uint8))
    data = frames.load(tmp_path / "a.npz")
    lines = frames.compare(data, frames.compute(data))
    assert data.size == 50
    assert [line.name for line in lines] == ["ClusterShape ego", "worst ego frame"]
    assert not any(line.passed for line in lines)


def _broken(records: str, **changes: Any) -> dict[str, Any]:
    changed = json.loads(records)
    changed[1].update(changes)
    return {"records": np.array(json.dumps(changed))}


DAMAGES = {
    "no records": lambda _: {"ego": np.zeros((1, 4, 4, 3), np.uint8)},
    "no JSON": lambda _: {"records": np.array("[{")},
    "no states": lambda _: {"records": np.array("[]")},
    "frames missing": lambda r: {
        "records": np.array(r), "ego": np.zeros((2, 4, 4, 3), np.uint8)
    },
    "floats": lambda r: {"records": np.array(r), "ego": np.zeros((3, 4, 4, 3))},
    "two sizes": lambda r: {
        "records": np.array(r),
        "ego": np.zeros((3, 4, 4, 3), np.uint8),
        "allo": np.zeros((3, 5, 5, 3), np.uint8),
    },
    "unknown shape": lambda r: _broken(r, blocks=[["cube", "red", 0, 0, 0]]),
    "no robot": lambda r: _broken(r, robot=[0, 0]),
    "one pupil": lambda r: _broken(r, pupil_angles=[0.0]),
    "not finite": lambda r: _broken(r, finger_angles=[0.0, float("nan")]),
    "no environment": lambda r: _broken(r, env=None),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_contents(damage: Any, records: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "bad.npz", **damage(records))
    with pytest.raises(RecordingError, match=r"bad\.npz: expected"):
        frames.load(tmp_path / "bad.npz")


def test_damaged_files(shared: Path, tmp_path: Path) -> None:
    whole = shared / "reference" / "frames-384.npz"
    shutil.copy(whole, tmp_path / "cut.npz")
    with (tmp_path / "cut.npz").open("r+b") as file:
        file.truncate(whole.stat().st_size // 2)
    data = bytearray(whole.read_bytes())
    data[len(data) // 3] ^= 0xFF
    (tmp_path / "flipped.npz").write_bytes(data)
    (tmp_path / "text.npz").write_text("not an archive")
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "single.npy", np.zeros(3))
    np.savez(tmp_path / "pickle.npz", records=np.array([{}], object))
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises(RecordingError, match=path.name):
            frames.load(path)
    with pytest.raises(RecordingError, match="cannot be read"):
        frames.load(tmp_path / "missing.npz")
