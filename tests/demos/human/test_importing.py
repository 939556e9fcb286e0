"""Importing the published human demonstrations; summary and replay of them."""

import gzip
import hashlib
import pickle
from collections import OrderedDict, namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, Trajectory
from magical.demos.human.importing import find_published, import_published
from magical.demos.human.published import published_sums, read_demonstration
from magical.errors import DatasetError
from tests.demos.conftest import Run


@pytest.fixture(scope="session")
def human(human_archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All 40 files, imported as frames."""
    out = tmp_path_factory.mktemp("human") / "dataset"
    report = import_published(find_published(human_archive), out, keep="frames")
    assert len(report.imported) == 40
    assert (report.failed, report.duplicates, report.already) == ([], [], [])
    return out


class Unpickler(pickle.Unpickler):
    """Reads the published files independently, with real arrays."""

    def find_class(self, module: str, name: str) -> Any:
        known = {
            "_reconstruct": np._core.multiarray._reconstruct,  # type: ignore[attr-defined]
            "ndarray": np.ndarray,
            "dtype": np.dtype,
            "OrderedDict": OrderedDict,
            "MILBenchTrajectory": namedtuple("MILBenchTrajectory", "acts obs rews infos"),
        }
        return known[name]


@pytest.mark.parametrize("task", ["move-to-region", "fix-colour", "find-dupe"])
def test_frames_are_the_4_x_4_average(human: Path, human_archive: Path, task: str) -> None:
    for file in sorted((human_archive / task).iterdir())[:2]:
        with gzip.open(file) as opened:
            data = Unpickler(opened).load()
        (entry,) = (e for e in Dataset.open(human).entries if e.source == file.name)
        stored = Dataset.open(human).read(entry)
        assert stored.frames is not None
        assert stored.published_code_score == data["score"]
        np.testing.assert_array_equal(stored.actions, data["trajectory"].acts)
        assert len(stored.frames["ego"]) == len(data["trajectory"].obs)
        for time, observation in enumerate(data["trajectory"].obs):
            for view in ("allo", "ego"):
                blocks = observation[view].reshape(96, 4, 96, 4, 3).astype(np.float64)
                average = np.round(blocks.mean(axis=(1, 3))).astype(np.uint8)
                np.testing.assert_array_equal(stored.frames[view][time], average)


def test_all_forty_are_complete_and_as_published(human: Path, human_archive: Path) -> None:
    lengths = {"MoveToCorner": 80, "MoveToRegion": 40, "MatchRegions": 120, "MakeLine": 180}
    lengths |= {"FindDupe": 100, "FixColour": 60, "ClusterColour": 240, "ClusterShape": 240}
    dataset = Dataset.open(human)
    for entry, trajectory in zip(dataset.entries, dataset, strict=True):
        assert (len(trajectory), trajectory.demonstrator) == (lengths[entry.task], "human")
        assert trajectory.scene == trajectory.task.demo
        assert (trajectory.score, trajectory.poses) == (None, None)
        assert trajectory.published_code_score == 1.0
        (file,) = human_archive.glob(f"*/{entry.source}")
        assert entry.source_sha256 == published_sums()[f"{file.parent.name}/{file.name}"]


def test_first_frame_is_the_demo_scene(human: Path) -> None:
    from magical.demos import Frames
    from magical.scene import Dynamics, Poses

    for task in ("MoveToCorner", "ClusterShape", "FixColour"):
        recorded = Dataset.open(human).filter(task=task)[0]
        assert recorded.frames is not None
        start = Poses.at_rest(recorded.scene).bodies
        rendered = Trajectory.from_poses(
            recorded.env_id, recorded.scene, [0], np.stack([start, start]), dynamics=Dynamics()
        )
        for view in ("ego", "allo"):
            ours = Frames(rendered, view).take([0])[0]
            assert np.abs(ours.astype(int) - recorded.frames[view][0]).mean() < 1.0


def test_import_again_changes_nothing(human: Path, human_archive: Path, run: Run) -> None:
    before = (human / "manifest.jsonl").read_bytes()
    status, result = run("import", human_archive / "fix-colour", "--out", human, "--frames-only")
    assert (status, result["imported"], len(result["already"])) == (0, [], 5)
    assert (human / "manifest.jsonl").read_bytes() == before


def test_duplicates_are_reported(tmp_path: Path, published: Any, run: Run) -> None:
    pickled = published().pickle
    for level, name in enumerate(("018", "019", "020"), 1):
        data = pickled if level > 1 else published(seed=1).pickle
        (tmp_path / f"demo-{name}.pkl.gz").write_bytes(gzip.compress(data, level, mtime=level))
    pair = ["demo-020.pkl.gz", "demo-019.pkl.gz"]
    status, result = run("import", tmp_path, "--out", tmp_path / "all")
    assert (status, result["duplicates"], len(result["imported"])) == (0, [pair], 3)
    status, result = run("info", tmp_path / "all")
    assert (status, result["duplicates"]) == (0, [pair])
    status, result = run("import", tmp_path, "--out", tmp_path / "once", "--skip-duplicates")
    assert (status, result["duplicates"], len(result["imported"])) == (0, [pair], 2)


def test_duplicates_of_one_name_are_found_by_their_content(
    tmp_path: Path, published: Any, run: Run
) -> None:
    pickled, name = published().pickle, "demo-019.pkl.gz"
    for level, folder in enumerate(("a", "b", "c"), 1):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_bytes(gzip.compress(pickled, level, mtime=level))
    out, twice = tmp_path / "once", [str(tmp_path / "b" / name), name]
    status, result = run("import", tmp_path, "--out", out, "--skip-duplicates")
    assert (status, result["imported"]) == (0, [name])
    assert result["duplicates"] == [twice, [str(tmp_path / "c" / name), name]]
    status, result = run("import", tmp_path / "b", "--out", out, "--skip-duplicates")
    assert (status, result["imported"], result["duplicates"]) == (0, [], [twice])
    status, result = run("import", tmp_path / "b", "--out", tmp_path / "all")
    status, result = run("import", tmp_path / "a", "--out", tmp_path / "all")
    assert (status, len(result["imported"]), len(result["duplicates"])) == (0, 1, 1)


def test_sums_of_the_published_archive() -> None:
    sums = published_sums()
    text = "".join(f"{digest}  {path}\n" for path, digest in sums.items())
    sha256 = "e58d49ee1ac3309353a901573f38ce8519dcfc4eef4247e2d141bcb93f206566"
    assert hashlib.sha256(text.encode()).hexdigest() == sha256
    assert len(set(sums.values())) == 203  # duplicates are compressed differently


def test_info_and_replay(human: Path, run: Run) -> None:
    status, result = run("info", human)
    assert (status, result["count"], result["problems"]) == (0, 40, [])
    assert {e["count"] for e in result["environments"]} == {5}
    for environment in result["environments"]:
        assert sum(environment["actions"]) == 5 * environment["lengths"][0]
    status, result = run("replay", human)
    assert status == 0
    assert len(result["replays"]) == 40
    means = {e["env_id"].split("/")[1]: e for e in result["environments"]}
    for task in ("MoveToRegion", "FindDupe", "FixColour"):
        assert means[f"{task}-Demo-v0"]["published_code_score"] == 1.0
        assert means[f"{task}-Demo-v0"]["published_replay"] == [1.0, 1.0]
    assert means["MoveToCorner-Demo-v0"]["published_code_score"] >= 0.6
    assert means["MatchRegions-Demo-v0"]["published_code_score"] >= 0.4


def test_source_without_published_files(tmp_path: Path) -> None:
    for source in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DatasetError, match="expected files"):
            find_published(source)
    assert main(["demos", "import", str(tmp_path), "--out", str(tmp_path / "out")]) == 1


def test_hand_made_file_is_read_as_the_published_ones(tmp_path: Path, published: Any) -> None:
    made = published()
    trajectory = read_demonstration(made.write(tmp_path / "demo.pkl.gz")).trajectory()
    assert trajectory.frames is not None
    for k, view in enumerate(("allo", "ego")):
        blocks = made.frames[:, k].reshape(3, 96, 4, 96, 4, 3).astype(np.float64)
        average = np.round(blocks.mean(axis=(2, 4)))
        np.testing.assert_array_equal(trajectory.frames[view], average)
    assert trajectory.actions.tolist() == made.actions.tolist()
    assert trajectory.published_code_score == 0.75


@pytest.mark.parametrize("frames_only", [False, True])
def test_a_file_without_recoverable_poses_keeps_its_frames(
    tmp_path: Path, published: Any, run: Run, frames_only: bool
) -> None:
    file = published().write(tmp_path / "demo.pkl.gz")
    command = ("import", file, "--out", tmp_path / "d", "--workers", 1)
    status, result = run(*command, *["--frames-only"][: int(frames_only)])
    assert (status, result["imported"]) == (0, ["demo.pkl.gz"])
    (trajectory,) = Dataset.open(tmp_path / "d")
    assert trajectory.frames is not None
    assert (trajectory.poses, trajectory.is_recovered) == (None, False)
    assert ("recovery" in trajectory.metadata) == (not frames_only)
    if frames_only:
        assert result["without_poses"] == []
        assert main(["demos", *map(str, command), "--frames-only", "--keep-frames"]) == 2
    else:
        ((name, why),) = result["without_poses"]
        assert name == "demo.pkl.gz"
        assert "does not start in the Demo scene" in why
