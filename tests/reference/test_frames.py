"""Comparison of the renderer with recorded frames."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.evaluation import published_tasks
from magical.scene import View
from magical.tasks import get_task
from tests.reference import frames
from tests.reference.recordings import DATA, RecordingError

ROUNDING = 0.01  # of 255: single samples on an edge, which rounding puts on either side


@pytest.fixture(scope="module", params=[96, 384])
def recording(request: pytest.FixtureRequest) -> frames.RecordedFrames:
    return frames.load(DATA / f"frames-{request.param}.npz")


def test_within_limits(recording: frames.RecordedFrames) -> None:
    comparisons = frames.compare(recording, frames.compute(recording))
    assert [each for each in comparisons if not each.passed] == []
    expected = {f"{task} {view}" for task in published_tasks() for view in View}
    assert {each.name for each in comparisons} == expected | {"worst ego frame", "worst allo frame"}
    regions = [each for each in comparisons if each.limit == frames.REGION_LIMIT]
    with_regions = {each.name.split()[0] for each in regions}
    assert with_regions == {name for name in published_tasks() if get_task(name).demo.regions}
    assert max(each.figure for each in comparisons) < ROUNDING


def test_a_wrong_frame_is_detected(recording: frames.RecordedFrames) -> None:
    first = dataclasses.replace(recording, **_only_first(recording))
    rendered = frames.compute(first)
    rendered[View.EGO] = rendered[View.EGO][:, ::-1]
    failed = {each.name for each in frames.compare(first, rendered) if not each.passed}
    assert failed == {f"{first.tasks[0]} ego", "worst ego frame"}


def _only_first(recording: frames.RecordedFrames) -> dict[str, Any]:
    cut = {name: getattr(recording, name)[:1] for name in ("scenes", "poses", "tasks", "names")}
    return {**cut, "frames": {view: array[:1] for view, array in recording.frames.items()}}


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


def test_one_view_is_enough(records: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", records=np.array(records), ego=np.zeros((3, 50, 50, 3), np.uint8))
    data = frames.load(tmp_path / "a.npz")
    comparisons = frames.compare(data, frames.compute(data))
    assert data.size == 50
    assert [each.name for each in comparisons] == ["ClusterShape ego", "worst ego frame"]
    assert not any(each.passed for each in comparisons)


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
    "unknown environment": lambda r: _broken(r, env="MoveToMoon-Demo-v0"),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_contents(damage: Any, records: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "bad.npz", **damage(records))
    with pytest.raises(RecordingError, match=r"bad\.npz: expected"):
        frames.load(tmp_path / "bad.npz")


def test_damaged_files(tmp_path: Path) -> None:
    whole = DATA / "frames-384.npz"
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
