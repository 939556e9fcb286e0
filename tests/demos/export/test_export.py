"""Exports, read again by the libraries they are for."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from magical.cli import main
from magical.demos import Dataset, DatasetWriter, Trajectory, observations
from magical.errors import DatasetError, TrajectoryError
from magical.observe import PRESETS

MakeTrajectory = Callable[..., Trajectory]
MISSING = "an optional extra that the pinned development environment has"


@pytest.fixture
def mixed(
    tmp_path: Path, make_trajectory: MakeTrajectory, make_frames_trajectory: MakeTrajectory
) -> Path:
    """Two environments with poses, one with frames."""
    path = tmp_path / "mixed"
    writer = DatasetWriter(path)
    for seed in (1, 2):
        writer.append(make_trajectory(steps=6, seed=seed))
    writer.append(make_trajectory("magical/MatchRegions-TestAll-v0", steps=5, seed=3))
    writer.append(make_frames_trajectory(steps=4))
    return path


@pytest.mark.parametrize("preset", ["LoRes4E", "LoResStack", "LoResCHW4E"])
def test_minari_export_is_lossless(
    mixed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    minari = pytest.importorskip("minari", reason=MISSING)
    from magical.demos.export.minari import export_minari

    dataset, root = Dataset.open(mixed), tmp_path / "minari"
    names = export_minari(dataset, name="mine", preset=preset, root=root)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    assert sorted(minari.list_local_datasets()) == sorted(names)
    for name in names:
        task, variant, _ = name.split("/")[1].split("-")
        part = dataset.filter(task=task, variant=variant)
        loaded = minari.load_dataset(name)
        assert loaded.observation_space == PRESETS[preset].space
        assert loaded.action_space.n == 18
        assert len(loaded) == len(part)
        assert not loaded.storage.jpeg_encoding
        for episode, trajectory in zip(loaded, part, strict=True):
            expected = observations(trajectory, preset)
            if isinstance(expected, dict):
                for view in expected:
                    np.testing.assert_array_equal(episode.observations[view], expected[view])
            else:
                np.testing.assert_array_equal(episode.observations, expected)
            np.testing.assert_array_equal(episode.actions, trajectory.actions)
            assert episode.truncations.tolist() == [False] * (len(trajectory) - 1) + [True]
            assert not episode.terminations.any()
            assert episode.infos["published_code_score"][-1] == trajectory.published_code_score
        (first, *_) = loaded.storage.get_episode_metadata([0])
        assert first["demonstrator"] == part[0].demonstrator
    recovered = minari.load_dataset(names[0]).recover_environment()
    assert recovered.observation_space == PRESETS[preset].space


def test_refused_minari_export_leaves_no_files(mixed: Path, tmp_path: Path) -> None:
    pytest.importorskip("minari", reason=MISSING)
    from magical.demos.export.minari import export_minari

    root = tmp_path / "minari"
    part = Dataset.open(mixed).filter(task="MoveToCorner")
    export_minari(part, root=root)
    before = sorted(root.rglob("*"))
    with pytest.raises(DatasetError, match="there is a dataset of that name"):
        export_minari(part, root=root)
    with pytest.raises(DatasetError, match="expected one of LoResStack"):
        export_minari(part, preset="raw", root=root)
    broken = mixed / part.entries[1].file
    broken.write_bytes(broken.read_bytes()[:-50])
    with pytest.raises(DatasetError, match=broken.name):
        export_minari(part, name="other", root=root)
    assert sorted(root.rglob("*")) == before


def test_lerobot_export_is_readable(mixed: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason=MISSING)
    pq = pytest.importorskip("pyarrow.parquet", reason=MISSING)
    from magical.demos.export.lerobot import export_lerobot

    root, dataset = tmp_path / "lerobot", Dataset.open(mixed).filter(demonstrator="random")
    assert export_lerobot(dataset, root, frames_per_file=10) == 17
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
        assert {step["task_index"] for step in steps} == {tasks[trajectory.task.summary]}
        assert trajectory.poses is not None
        np.testing.assert_allclose(
            [step["observation.state"][:3] for step in steps], trajectory.poses[:-1, 0], atol=1e-6
        )
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


def decoded(av: Any, path: Path) -> list[tuple[float, Any]]:
    with av.open(str(path)) as video:
        return [
            (float(frame.pts * frame.time_base), frame.to_ndarray(format="rgb24"))
            for frame in video.decode(video=0)
        ]


def test_lerobot_statistics(mixed: Path, tmp_path: Path) -> None:
    pytest.importorskip("av", reason=MISSING)
    pytest.importorskip("pyarrow", reason=MISSING)
    from magical.demos.export.lerobot import export_lerobot

    dataset = Dataset.open(mixed)
    export_lerobot(dataset, tmp_path / "lerobot")
    stats = json.loads((tmp_path / "lerobot" / "meta" / "stats.json").read_text())
    arrays = dataset.arrays(preset="LoRes4E")
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
    pytest.importorskip("av", reason=MISSING)
    pytest.importorskip("pyarrow", reason=MISSING)
    broken = mixed / Dataset.open(mixed).entries[1].file
    broken.write_bytes(b"")
    before = sorted(tmp_path.iterdir())
    command = ["demos", "export", str(mixed), "--to", "lerobot", "--out", str(tmp_path / "lr")]
    assert main(command) == 1
    assert sorted(tmp_path.iterdir()) == before
    assert main([*command, "--skip-damaged"]) == 0
    assert json.loads((tmp_path / "lr/meta/info.json").read_text())["total_episodes"] == 3


def test_lerobot_needs_a_folder(mixed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demos", "export", str(mixed), "--to", "lerobot"]) == 1
    assert "--out" in capsys.readouterr().err


def test_video_as_webp(mixed: Path, tmp_path: Path) -> None:
    out = tmp_path / "video.webp"
    chosen = ["--index", "2", "--index", "3"]
    assert main(["demos", "video", str(mixed), "--out", str(out), *chosen]) == 0
    with Image.open(io.BytesIO(out.read_bytes())) as video:
        assert video.size == (768, 416)
        assert video.n_frames == 6 + 5  # frames that repeat are shown longer
        video.seek(0)
        start = np.asarray(video.convert("RGB")).astype(int)
        video.seek(5)
        assert np.abs(np.asarray(video.convert("RGB")).astype(int) - start)[32:].max() > 30


def test_video_as_mp4(mixed: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason=MISSING)
    pytest.importorskip("imageio_ffmpeg", reason=MISSING)
    from magical.demos.export.video import LAST_FRAME_REPEATS

    out = tmp_path / "video.mp4"
    assert main(["demos", "video", str(mixed), "--out", str(out)]) == 0
    video = decoded(av, out)
    assert len(video) == 7 + 6 + 5 + 3 * LAST_FRAME_REPEATS  # one of each environment
    assert video[0][1].shape == (416, 768, 3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["video.mp4", "mixed"]


def test_video_has_both_views_and_the_score(make_frames_trajectory: MakeTrajectory) -> None:
    from magical.demos.export.video import BANNER, video_frames

    recorded = make_frames_trajectory()
    first, *_, last = video_frames(recorded)
    assert recorded.frames is not None
    np.testing.assert_array_equal(first[BANNER::4, :384:4], recorded.frames["ego"][0])
    np.testing.assert_array_equal(last[BANNER::4, 384::4], recorded.frames["allo"][-1])
    assert (first[:BANNER] != last[:BANNER]).any()


@pytest.mark.parametrize("change", [["--out", "video.avi"], ["--out", "f.webp", "--index", "9"]])
def test_invalid_video_options(mixed: Path, change: list[str]) -> None:
    assert main(["demos", "video", str(mixed), *change]) in (1, 2)


def test_recorded_frames_lack_the_raw_observation(mixed: Path) -> None:
    with pytest.raises(TrajectoryError):
        Dataset.open(mixed).arrays(preset="raw")
