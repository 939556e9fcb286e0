"""Datasets: exact, small, readable in part, and appended to by several processes."""

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.errors import DatasetError, UnknownNameError
from magical.tasks import get_task, register_task, unregister_task
from tests.demos.conftest import make_frames_trajectory, make_trajectory


def assert_equal(a: Trajectory, b: Trajectory) -> None:
    for field in fields(Trajectory):
        ours, theirs = getattr(a, field.name), getattr(b, field.name)
        assert type(ours) is type(theirs), field.name
        np.testing.assert_equal(ours, theirs)


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    made = [
        make_trajectory("magical/FixColour-TestAll-v0", metadata={"name": "me", "deep": [1, {}]}),
        make_trajectory(steps=4, expert_actions=[0, 17, 3, 3]),
        make_trajectory(steps=3, actors=[0, 2, 1], policy_actions=[3, 0, 17]),
        make_trajectory().with_action_space("continuous"),
        make_frames_trajectory(),
        replace(
            make_trajectory("magical/FindDupe-Demo-v0", steps=3),
            frames=make_frames_trajectory().frames,
        ),
    ]
    writer = DatasetWriter(tmp_path)
    entries = [writer.append(trajectory) for trajectory in made]
    dataset = Dataset.open(tmp_path)
    assert list(dataset.entries) == entries
    for entry, ours, read in zip(entries, made, dataset, strict=True):
        assert_equal(ours, read)
        assert (entry.length, entry.action_space) == (len(ours), ours.action_space)
        assert (entry.env_id, entry.score, entry.seed) == (ours.env_id, ours.score, ours.seed)
        assert entry.has_poses == (ours.bodies is not None)
        assert entry.has_labels == (ours.expert_actions is not None)


def test_a_task_that_is_not_registered_is_listed_but_not_read(tmp_path: Path) -> None:
    register_task(replace(get_task("MakeLine"), name="Gone", section=""))
    try:
        DatasetWriter(tmp_path).append(make_trajectory("magical/Gone-Demo-v0"))
    finally:
        unregister_task("Gone")
    dataset = Dataset.open(tmp_path)
    assert dataset.entries[0].task == "Gone"
    with pytest.raises(DatasetError, match=r"npz: task 'Gone' is not .*; import or install"):
        dataset[0]


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ({"task": "MoveToCorner"}, [1, 3]),
        ({"task": "MakeLine"}, []),
        ({"task": "MoveToCornr"}, "did you mean 'MoveToCorner'"),
        ({"variant": "Jitter"}, [3]),
        ({"variant": "demo"}, "not a variant"),
        ({"demonstrator": "other"}, [2]),
        ({"env_id": "MoveToCorner-Demo-LoRes4E-v0"}, [1]),
        ({"min_score": 0.9}, [4]),  # frames, of which only the published code's score is known
    ],
)
def test_filter(
    small_dataset: Path,
    condition: dict[str, Any],
    expected: list[int] | str,
) -> None:
    DatasetWriter(small_dataset).append(make_frames_trajectory(seed=4, published_code_score=0.9))
    dataset = Dataset.open(small_dataset)
    if isinstance(expected, str):
        with pytest.raises(UnknownNameError, match=expected):
            dataset.filter(**condition)
    else:
        found = [int(entry.file[:6]) + 1 for entry in dataset.filter(**condition).entries]
        assert found == expected


def test_a_sample_depends_on_the_generator_alone(small_dataset: Path) -> None:
    dataset = Dataset.open(small_dataset)
    samples = [dataset.sample(2, np.random.default_rng(seed)).entries for seed in (0, 0, 1, 2, 3)]
    assert samples[0] == samples[1]
    assert len({tuple(entry.file for entry in sample) for sample in samples}) > 1
    with pytest.raises(DatasetError, match="expected 4 trajectories, found 3"):
        dataset.sample(4, np.random.default_rng(0))


def test_several_writers_append_at_once(tmp_path: Path, small_dataset: Path) -> None:
    """In threads here, as processes would: what they share is the folder."""
    writers = [DatasetWriter(tmp_path / "target") for _ in range(3)]
    with ThreadPoolExecutor(3) as threads:
        for _ in range(10):
            list(threads.map(DatasetWriter.append, writers, Dataset.open(small_dataset)))
    seeds = [entry.seed for entry in Dataset.open(tmp_path / "target").entries]
    assert sorted(seeds) == [1] * 10 + [2] * 10 + [3] * 10


KILLED = """
import os, signal, sys
from pathlib import Path
from magical.demos import Dataset, DatasetWriter
Path.replace = os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
DatasetWriter(sys.argv[2]).append(Dataset.open(sys.argv[1])[0])
"""


@pytest.mark.posix
def test_a_killed_writer_leaves_what_was_there(tmp_path: Path, small_dataset: Path) -> None:
    before = Dataset.open(small_dataset).entries
    command = [sys.executable, "-c", KILLED, str(small_dataset), str(small_dataset)]
    assert subprocess.run(command, check=False).returncode < 0
    assert Dataset.open(small_dataset).entries == before
    DatasetWriter(small_dataset).append(Dataset.open(small_dataset)[0])
    assert len(Dataset.open(small_dataset)) == 4


def test_a_full_disk_leaves_what_was_there(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset, before = Dataset.open(small_dataset), sorted(small_dataset.iterdir())

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(DatasetError, match="cannot be written: No space left"):
        DatasetWriter(small_dataset).append(dataset[0])
    assert sorted(small_dataset.iterdir()) == before


def test_folders_with_something_else_are_no_datasets(tmp_path: Path) -> None:
    (tmp_path / ".DS_Store").touch()
    assert len(Dataset.open(DatasetWriter(tmp_path).path)) == 0
    (tmp_path / "config.json").touch()
    with pytest.raises(DatasetError, match=r"found \['config.json'\]"):
        DatasetWriter(tmp_path)
    with pytest.raises(DatasetError, match="expected a dataset"):
        Dataset.open(tmp_path / "none")


def test_the_stored_human_demonstrations_are_read(human_trajectories: Path) -> None:
    """They were written by version 1, with a manifest; in another folder there are their poses."""
    dataset = Dataset.open(human_trajectories)
    lines = (human_trajectories / "manifest.jsonl").read_text().splitlines()[1:]
    for entry, line in zip(dataset.entries, map(json.loads, lines), strict=True):
        assert (entry.file, entry.length) == (line["file"], line["length"])
        assert (entry.env_id, entry.name) == (line["env_id"], line["source"])
        assert entry.published_code_score == line["published_code_score"]
    assert (dataset[0].bodies, dataset[0].frames["ego"].shape) == (None, (241, 96, 96, 3))
    poses = Dataset.open(human_trajectories.parent / "human-poses")
    first = poses[0]
    assert (len(poses), first.bodies.shape) == (203, (241, 13, 6))
    again = Trajectory.from_bodies(first.env_id, first.scene, first.actions, first.poses)
    assert_equal(first, replace(again, demonstrator="human", metadata=first.metadata))
