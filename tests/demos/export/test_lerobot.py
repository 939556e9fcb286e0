"""Exports to LeRobot, read again by PyArrow and PyAV."""

import json
from pathlib import Path

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, observations
from magical.errors import DatasetError
from magical.scene.poses import FINGERS, ROBOT
from tests.demos.export.conftest import MISSING, decoded

av = pytest.importorskip("av", reason=MISSING)
pq = pytest.importorskip("pyarrow.parquet", reason=MISSING)
from magical.demos.export.lerobot import export_lerobot  # noqa: E402


def test_lerobot_export_is_readable(
    mixed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magical.demos.export.lerobot.FRAMES_PER_FILE", 10)
    root, dataset = tmp_path / "lerobot", Dataset.open(mixed).filter(demonstrator="random")
    assert export_lerobot(dataset, root) == 17
    info = json.loads((root / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_frames"]) == ("v3.0", 8, 17)
    assert (info["total_episodes"], info["splits"]) == (3, {"train": "0:3"})
    episodes = pq.read_table(root / "meta" / "episodes").to_pylist()
    listed = pq.read_table(root / "meta" / "tasks.parquet").to_pylist()
    tasks = {row["task"]: row["task_index"] for row in listed}
    for number, (row, trajectory) in enumerate(zip(episodes, dataset, strict=True)):
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        table = pq.read_table(root / info["data_path"].format(**place)).to_pylist()
        steps = [step for step in table if step["episode_index"] == number]
        assert [step["index"] for step in steps] == list(
            range(row["dataset_from_index"], row["dataset_to_index"])
        )
        assert [step["action"] for step in steps] == trajectory.actions.tolist()
        assert [step["next.done"] for step in steps] == [False] * (len(steps) - 1) + [True]
        words = trajectory.task.instruction(trajectory.scene)
        assert row["tasks"] == [words]
        assert {step["task_index"] for step in steps} == {tasks[words]}
        assert trajectory.poses is not None
        robot, fingers = trajectory.poses[:-1, ROBOT], trajectory.poses[:-1, FINGERS, 2]
        np.testing.assert_allclose(
            [step["observation.state"] for step in steps],
            np.hstack([robot, fingers - robot[:, 2:]]),
            atol=1e-6,
        )
        assert [step["timestamp"] for step in steps] == [i / 8 for i in range(len(steps))]
        assert row["stats/action/mean"] == pytest.approx([trajectory.actions.mean()])
        for view in ("ego", "allo"):
            key = f"observation.images.{view}"
            assert info["features"][key]["shape"] == [96, 96, 3]
            place = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
            video = decoded(av, root / info["video_path"].format(video_key=key, **place))
            start = round(row[f"videos/{key}/from_timestamp"] * 8)
            assert row[f"videos/{key}/to_timestamp"] * 8 == start + len(trajectory)
            expected = observations(trajectory, "LoRes4E" if view == "ego" else "LoRes4A")
            assert isinstance(expected, np.ndarray)
            for step in range(len(trajectory)):
                time, frame = video[start + step]
                assert time == (start + step) / 8
                assert np.abs(frame.astype(int) - expected[step, :, :, -3:]).mean() < 2
    assert {row["data/file_index"] for row in episodes} == {0, 1}


def test_lerobot_actions_are_those_to_imitate(labelled: Dataset, tmp_path: Path) -> None:
    export_lerobot(labelled, tmp_path / "out")
    first, second = (trajectory.actions.tolist() for trajectory in labelled)
    table = pq.read_table(tmp_path / "out" / "data").to_pydict()
    assert table["action"] == [*first, 17, 0, 4]
    assert table["executed_action"] == [*first, *second]
    assert table["is_demonstrated"] == [False, True, False, True, True, True]
    features = json.loads((tmp_path / "out" / "meta" / "info.json").read_text())["features"]
    assert features["executed_action"] == features["action"] | {"names": None}
    stats = json.loads((tmp_path / "out" / "meta" / "stats.json").read_text())
    assert stats["executed_action"]["count"] == [6]


def test_lerobot_statistics(mixed: Path, tmp_path: Path) -> None:
    dataset = Dataset.open(mixed)
    export_lerobot(dataset, tmp_path / "lerobot")
    stats = json.loads((tmp_path / "lerobot" / "meta" / "stats.json").read_text())
    arrays = dataset.arrays(observation="LoRes4E")
    newest = arrays["observations"][..., -3:] / 255
    for name, values, axes in (
        ("action", arrays["actions"][:, None], (0,)),
        ("observation.images.ego", newest, (0, 1, 2)),
    ):
        for kind in ("min", "max", "mean", "std"):
            expected = getattr(values, kind)(axis=axes)
            np.testing.assert_allclose(np.ravel(stats[name][kind]), expected, atol=1e-9)
        assert stats[name]["count"] == [len(values)]
    assert np.shape(stats["observation.images.allo"]["mean"]) == (3, 1, 1)
    assert "observation.state" not in stats  # unknown for recordings of frames
    with pytest.raises(DatasetError, match="new folder"):
        export_lerobot(dataset, tmp_path / "lerobot")


def test_failed_lerobot_export_leaves_no_files(mixed: Path, tmp_path: Path) -> None:
    broken = mixed / Dataset.open(mixed).entries[1].file
    broken.write_bytes(b"")
    before = sorted(tmp_path.iterdir())
    command = ["demos", "export", str(mixed), "--to", "lerobot", "--out", str(tmp_path / "lr")]
    assert main(command) == 1
    assert sorted(tmp_path.iterdir()) == before
    assert main([*command, "--skip-damaged"]) == 0
    assert json.loads((tmp_path / "lr/meta/info.json").read_text())["total_episodes"] == 3


def test_lerobot_needs_a_folder(mixed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["demos", "export", str(mixed), "--to", "lerobot"]
    assert main(command) == 2
    assert "--out" in capsys.readouterr().err
    assert main([*command, "--name", "mine"]) == 2
    assert "--name: not for --to lerobot" in capsys.readouterr().err
