"""The commands that show, replay and export, read again by other libraries; the Hub is a folder."""

import json
import shutil
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, DatasetWriter, observations
from magical.demos.export import BANNER, LAST_FRAME_REPEATS, export_minari, pull, push, video_frames
from magical.errors import DatasetError
from magical.observe import PRESETS
from tests.demos.conftest import Run, make_frames_trajectory, make_trajectory

REPO = "someone/demos"


def test_info_counts_and_escapes(small_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    writer, escapes = DatasetWriter(small_dataset), {"demonstrator": "\x1b[2J\x07"}
    longer = make_trajectory(steps=14, seed=4, expert_actions=[1] * 14, **escapes)
    writer.append(replace(longer, score=1.0, published_code_score=0.5))
    copy = writer.append(Dataset.open(small_dataset)[1])
    assert main(["demos", "info", str(small_dataset), "--json"]) == 0
    shown = capsys.readouterr()
    assert all(line.isprintable() for line in (shown.out + shown.err).split("\n"))
    result = json.loads(shown.out.splitlines()[-1])
    assert (result["count"], result["duplicates"]) == (5, [[copy.file, "000001.npz"]])
    corner = result["environments"][1]
    assert corner["env_id"] == "magical/MoveToCorner-Demo-v0"
    assert [corner[name] for name in ("count", "with_poses", "with_labels")] == [2, 2, 1]
    assert (corner["lengths"], corner["score"], corner["published_code_score"]) == (
        [12, 14],
        0.5,
        0.25,
    )


def test_replays_agree_with_what_was_recorded(
    small_dataset: Path, tmp_path: Path, run: Run
) -> None:
    writer = DatasetWriter(tmp_path / "other")
    wrong = [{"score": 0.9}, {"published_code_score": 0.9}, {}]
    for trajectory, changes in zip(Dataset.open(small_dataset), wrong, strict=True):
        writer.append(replace(trajectory, **changes))
    status, result = run("replay", writer.path)
    assert (status, result["agree"]) == (0, 1)
    assert [one["agrees"] for one in result["replays"]] == [False, False, True]
    assert [one["departure"] for one in result["replays"]] == [0.0] * 3


@pytest.fixture
def mixed(small_dataset: Path) -> Path:
    """Three environments with poses, one with frames."""
    DatasetWriter(small_dataset).append(make_frames_trajectory(steps=4))
    return small_dataset


def test_a_video_has_the_first_of_each_environment_or_the_chosen(
    mixed: Path, tmp_path: Path, run: Run
) -> None:
    av = pytest.importorskip("av", reason="the video extra is not installed")
    out = tmp_path / "video.mp4"
    status, result = run("video", mixed, "--out", out, "--index", 3)
    assert (status, result["count"]) == (0, 1)
    with av.open(str(out)) as video:
        frames = list(video.decode(video=0))
    assert result["frames"] == len(frames) == 5 + LAST_FRAME_REPEATS
    assert frames[0].to_ndarray(format="rgb24").shape == (384 + BANNER, 768, 3)
    assert [float(frame.pts * frame.time_base) for frame in frames[:3]] == [0.0, 1 / 8, 2 / 8]
    assert run("video", mixed, "--out", out)[1]["count"] == 4
    assert main(["demos", "video", str(mixed), "--out", str(out), "--index", "9"]) == 1


def test_a_video_shows_both_views_and_the_score() -> None:
    recorded = make_frames_trajectory()
    first, *_, last = video_frames(recorded)
    for start, view in ((0, "ego"), (384, "allo")):
        columns = slice(start, start + 384, 4)
        np.testing.assert_array_equal(first[BANNER::4, columns], recorded.frames[view][0])
        np.testing.assert_array_equal(last[BANNER::4, columns], recorded.frames[view][-1])
    assert (first[:BANNER] != last[:BANNER]).any()


def test_a_minari_export_is_lossless(
    mixed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    run: Run,
) -> None:
    minari = pytest.importorskip("minari", reason="the minari extra is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    dataset = Dataset.open(mixed)
    for name in export_minari(dataset, name="mine"):
        task, variant, preset = name.split("/")[1].split("-")
        part, loaded = dataset.filter(task=task, variant=variant), minari.load_dataset(name)
        assert loaded.observation_space == PRESETS["LoRes4E"].space
        assert loaded.action_space.n == 18
        for episode, trajectory in zip(loaded, part, strict=True):
            np.testing.assert_equal(episode.observations, observations(trajectory, preset))
            np.testing.assert_array_equal(episode.actions, trajectory.actions)
            assert episode.truncations.tolist() == [False] * (len(trajectory) - 1) + [True]
            assert not episode.terminations.any()
            assert episode.infos["published_code_score"][-1] == trajectory.published_code_score
        recovered = loaded.recover_environment()
        assert recovered.observation_space == PRESETS["LoRes4E"].space
        recovered.reset(seed=0)
        assert [recovered.step(0)[3] for _ in range(len(trajectory))][-2:] == [False, True]
    with pytest.raises(DatasetError, match="Minari refuses"):
        export_minari(dataset, name="mine")
    labelled = DatasetWriter(tmp_path / "labelled")
    labelled.append(make_trajectory(steps=3, seed=1, actors=[0, 2, 0]))
    labelled.append(make_trajectory(steps=3, seed=2, expert_actions=[17, 0, 4]))
    command = ("export", labelled.path, "--to", "minari", "--out", tmp_path / "other")
    status, result = run(*command, "--preset", "LoResStack")
    assert (status, result["episodes"]) == (0, 2)
    first, second = minari.load_dataset(result["datasets"][0])
    assert "expert_action" not in first.infos
    assert first.infos["is_demonstrated"].tolist() == [False, True, False, False]
    assert second.infos["expert_action"].tolist() == [17, 0, 4, -1]


class Hub:
    """The calls of `huggingface_hub` that are made, on a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.created = folder, list[dict[str, Any]]()
        folder.mkdir()

    def create_repo(self, **options: Any) -> str:
        self.created.append(options)
        return f"https://hub/datasets/{REPO}"

    def upload_folder(self, folder_path: Path, allow_patterns: Any, **options: Any) -> None:
        for file in self.folder.glob("*"):
            if any(fnmatch(file.name, pattern) for pattern in options["delete_patterns"]):
                file.unlink()
        for name in allow_patterns:
            shutil.copy(folder_path / name, self.folder / name)

    def upload_file(self, path_or_fileobj: bytes, path_in_repo: str, **_: Any) -> None:
        (self.folder / path_in_repo).write_bytes(path_or_fileobj)

    def snapshot_download(self, _: str, local_dir: Path, allow_patterns: Any, **__: Any) -> None:
        Path(local_dir).mkdir()
        for file in self.folder.glob(allow_patterns[0]):
            shutil.copy(file, local_dir)


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Hub:
    library = pytest.importorskip("huggingface_hub", reason="the hub extra is not installed")
    made = Hub(tmp_path / "hub")
    monkeypatch.setattr(library, "HfApi", lambda: made)
    monkeypatch.setattr(library, "snapshot_download", made.snapshot_download)
    return made


def test_a_dataset_comes_back_from_the_hub_as_it_was(
    hub: Hub, small_dataset: Path, tmp_path: Path, run: Run
) -> None:
    dataset, back = Dataset.open(small_dataset), str(tmp_path / "back")
    status, result = run("push", small_dataset, REPO, "--licence", "cc-by-4.0", "--private")
    assert (status, result["count"], hub.created[0]["private"]) == (0, 3, True)
    card = (hub.folder / "README.md").read_text()
    assert card.startswith("---\nlicense: cc-by-4.0\n")
    assert "- 1 of magical/FindDupe-TestAll-v0 by other" in card
    assert run("pull", REPO, "--out", back) == (0, {"out": back, "count": 3})
    assert Dataset.open(back).entries == dataset.entries
    with pytest.raises(DatasetError, match="new folder"):
        pull(REPO, back)
    push(dataset[1:], REPO, "mit")
    assert list(pull(REPO, tmp_path / "some").entries) == list(dataset.entries[1:])


def test_what_may_not_be_pushed_and_what_the_hub_refuses_is_said_in_a_line(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(**_: Any) -> None:
        raise OSError("401: log in\nand more")

    monkeypatch.setattr(hub, "create_repo", denied)
    writer = DatasetWriter(tmp_path / "human")
    writer.append(make_trajectory())
    with pytest.raises(DatasetError, match=r"^someone/demos on the Hub: 401: log in$"):
        push(Dataset.open(writer.path), REPO, "mit")
    source = {"source": "demo-1.pkl.gz", "source_sha256": "a" * 64}
    writer.append(make_trajectory(metadata=source))
    with pytest.raises(DatasetError, match=r"without a licence, such as demo-1\.pkl\.gz"):
        push(Dataset.open(writer.path), REPO, "mit")
