"""Videos of demonstrations."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from magical.cli import main
from magical.demos import DatasetWriter, Trajectory
from magical.demos.export.video import BANNER, LAST_FRAME_REPEATS, video_frames, write_video
from magical.errors import DatasetError
from magical.scene.poses import FIRST_BLOCK
from tests.demos.conftest import MakeTrajectory
from tests.demos.export.conftest import MISSING, decoded


def test_video_as_webp(mixed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "video.webp"
    chosen = ["--index", "2", "3"]
    assert main(["demos", "video", str(mixed), "--out", str(out), *chosen, "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found == {"out": str(out), "count": 2, "frames": 6 + 5 + 2 * LAST_FRAME_REPEATS}
    with Image.open(io.BytesIO(out.read_bytes())) as video:
        assert video.size == (768, 416)
        assert video.n_frames == 6 + 5  # frames that repeat are shown longer
        video.seek(0)
        start = np.asarray(video.convert("RGB")).astype(int)
        assert video.info["duration"] == 125  # ms
        video.seek(5)
        assert np.abs(np.asarray(video.convert("RGB")).astype(int) - start)[32:].max() > 30


def test_video_as_mp4(mixed: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason=MISSING)
    out = tmp_path / "video.mp4"
    assert main(["demos", "video", str(mixed), "--out", str(out)]) == 0
    video = decoded(av, out)
    assert len(video) == 7 + 6 + 5 + 3 * LAST_FRAME_REPEATS  # one of each environment
    assert video[0][1].shape == (416, 768, 3)
    assert [time for time, _ in video[:3]] == [0.0, 1 / 8, 2 / 8]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mixed", "video.mp4"]


def test_a_video_of_nothing_is_refused(make_trajectory: MakeTrajectory, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"a\.webp: expected trajectories to show, found none"):
        write_video([], str(tmp_path / "a.webp"))
    assert not list(tmp_path.iterdir())
    assert write_video([make_trajectory(steps=1)], str(tmp_path / "a.WEBP")) > 0


def test_a_video_of_different_views_is_refused(
    make_frames_trajectory: MakeTrajectory, tmp_path: Path
) -> None:
    both = make_frames_trajectory()
    assert both.frames is not None
    one = replace(both, frames={"ego": both.frames["ego"]})
    with pytest.raises(DatasetError, match="expected trajectories with the same views"):
        write_video([both, one], tmp_path / "a.webp")
    assert not list(tmp_path.iterdir())
    assert write_video([one, one], tmp_path / "a.webp") > 0


def test_video_has_both_views_and_the_score(make_frames_trajectory: MakeTrajectory) -> None:
    recorded = make_frames_trajectory()
    first, *_, last = video_frames(recorded)
    assert recorded.frames is not None
    np.testing.assert_array_equal(first[BANNER::4, :384:4], recorded.frames["ego"][0])
    np.testing.assert_array_equal(last[BANNER::4, 384::4], recorded.frames["allo"][-1])
    assert (first[:BANNER] != last[:BANNER]).any()


def test_a_video_shows_the_score_of_every_time_step(make_trajectory: MakeTrajectory) -> None:
    unsolved = make_trajectory(steps=2)
    poses = np.array(unsolved.poses)
    poses[-1, FIRST_BLOCK, :2] = -0.8, 0.8  # in the corner
    solved = Trajectory.from_poses(
        unsolved.env_id, unsolved.scene, unsolved.actions, poses, demonstrator="random"
    )
    shown = [[frame[:BANNER] for frame in video_frames(one)] for one in (unsolved, solved)]
    same = [np.array_equal(*banners) for banners in zip(*shown, strict=True)]
    assert same == [True, True, *[False] * (1 + LAST_FRAME_REPEATS)]


@pytest.mark.parametrize("change", [["--out", "video.avi"], ["--out", "f.webp", "--index", "9"]])
def test_invalid_video_options(mixed: Path, change: list[str]) -> None:
    assert main(["demos", "video", str(mixed), *change]) in (1, 2)


def test_demonstrations_are_numbered_as_their_files_are(
    make_trajectory: MakeTrajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, video = tmp_path / "gaps", ["--out", str(tmp_path / "v.webp"), "--index"]
    writer = DatasetWriter(folder)
    for steps in (1, 2, 3):
        writer.append(make_trajectory(steps=steps))
    next(folder.glob("trajectories/000001-*")).unlink()
    assert main(["demos", "info", str(folder), "--repair"]) == 0
    assert main(["demos", "video", str(folder), *video, "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["frames"] == 4 + LAST_FRAME_REPEATS
    assert main(["demos", "video", str(folder), *video, "1"]) == 1
    assert "expected number 1, found 2 demonstrations" in capsys.readouterr().err


def test_a_webp_of_too_many_frames_is_refused(
    mixed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("magical.demos.export.video.MAX_WEBP_FRAMES", 3)
    out = tmp_path / "video.webp"
    assert main(["demos", "video", str(mixed), "--out", str(out)]) == 1
    assert "write .mp4" in capsys.readouterr().err
    assert not out.exists()
