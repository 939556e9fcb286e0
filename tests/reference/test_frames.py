"""Comparison of the renderer with recorded frames."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.scene import View
from tests.reference import frames
from tests.reference.recordings import DATA, RecordingError


def test_a_wrong_frame_is_detected() -> None:
    recording = frames.load(DATA / "frames-96.npz")
    cut = {name: getattr(recording, name)[:1] for name in ("scenes", "poses", "tasks", "names")}
    views = {view: array[:1] for view, array in recording.frames.items()}
    first = dataclasses.replace(recording, **cut, frames=views)
    rendered = frames.compute(first)
    rendered[View.EGO] = rendered[View.EGO][:, ::-1]
    failed = {each.name for each in frames.compare(first, rendered) if not each.passed}
    assert failed == {f"{first.tasks[0]} ego", "worst ego frame"}


@pytest.fixture(scope="module")
def records() -> str:
    with np.load(DATA / "frames-96.npz", allow_pickle=False) as archive:
        return json.dumps(json.loads(str(archive["records"]))[:3])


@pytest.mark.parametrize(("name", "size"), [("states.npz", 96), ("frames-384.npz", 384)])
def test_without_frames_it_only_computes(
    name: str, size: int, records: str, tmp_path: Path
) -> None:
    np.savez(tmp_path / name, records=np.array(records))
    data = frames.load(tmp_path / name)
    rendered = frames.compute(data)
    assert frames.compare(data, rendered) == []
    frames.write(rendered, tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz", allow_pickle=False) as archive:
        assert set(archive) == {"allo", "ego"}
        for view in View:
            assert archive[view].shape == (3, size, size, 3)
            np.testing.assert_array_equal(archive[view], rendered[view])


def test_one_view_of_another_size_is_enough(records: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", records=np.array(records), ego=np.zeros((3, 50, 50, 3), np.uint8))
    data = frames.load(tmp_path / "a.npz")
    comparisons = frames.compare(data, frames.compute(data))
    assert [each.name for each in comparisons] == ["ClusterShape ego", "worst ego frame"]
    assert not any(each.passed for each in comparisons)


DAMAGES: dict[str, dict[str, Any]] = {
    "frames missing": {"ego": np.zeros((2, 4, 4, 3), np.uint8)},
    "floats": {"ego": np.zeros((3, 4, 4, 3))},
    "no records": {"records": np.array("[{")},
    "pickle": {"records": np.array([{}], object)},
    "unknown shape": {"blocks": [["cube", "red", 0, 0, 0]]},
    "one pupil": {"pupil_angles": [0.0]},
    "not finite": {"finger_angles": [0.0, float("nan")]},
    "unknown environment": {"env": "MoveToMoon-Demo-v0"},
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_contents(damage: dict[str, Any], records: str, tmp_path: Path) -> None:
    changed = json.loads(records)
    arrays = {name: array for name, array in damage.items() if isinstance(array, np.ndarray)}
    changed[1].update({} if arrays else damage)
    np.savez(tmp_path / "bad.npz", **{"records": np.array(json.dumps(changed)), **arrays})
    with pytest.raises(RecordingError, match=r"bad\.npz: expected"):
        frames.load(tmp_path / "bad.npz")


@pytest.mark.parametrize("end", [0, 30, -1000])
def test_truncated_files(end: int, tmp_path: Path) -> None:
    (tmp_path / "cut.npz").write_bytes((DATA / "frames-384.npz").read_bytes()[:end])
    with pytest.raises(RecordingError, match=r"cut\.npz"):
        frames.load(tmp_path / "cut.npz")
