"""Datasets: exact, small, and appended to by several processes."""

import subprocess
import sys
import tracemalloc
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.demos.store.codec import decode, encode
from magical.errors import DatasetError, UnknownNameError
from magical.tasks import get_task, register_task, unregister_task
from tests.demos.conftest import MakeTrajectory


def assert_equal(a: Trajectory, b: Trajectory) -> None:
    for field in fields(Trajectory):
        ours, theirs = getattr(a, field.name), getattr(b, field.name)
        assert type(ours) is type(theirs), field.name
        if isinstance(ours, np.ndarray) or field.name == "frames":
            np.testing.assert_equal(ours, theirs)
        else:
            assert ours == theirs, field.name


def test_round_trip_is_exact(
    make_trajectory: MakeTrajectory, make_frames_trajectory: MakeTrajectory
) -> None:
    posed = make_trajectory(
        "magical/FixColour-TestAll-v0", metadata={"name": "me", "deep": [1, {}]}
    )
    labelled = make_trajectory(steps=4, expert_actions=[0, 17, 3, 3])
    watched = make_trajectory(steps=3, actors=[0, 2, 1], policy_actions=[3, 0, 17])
    for trajectory in (posed, labelled, watched, make_frames_trajectory()):
        assert_equal(trajectory, decode(encode(trajectory)))
        assert encode(trajectory) == encode(decode(encode(trajectory)))


def test_a_task_that_is_not_registered_is_named(make_trajectory: MakeTrajectory) -> None:
    register_task(replace(get_task("MakeLine"), name="Gone", section=""))
    try:
        raw = encode(make_trajectory("magical/Gone-Demo-v0"))
    finally:
        unregister_task("Gone")
    with pytest.raises(DatasetError, match=r"^task 'Gone' is not .*; import or install"):
        decode(raw)


def test_largest_trajectory_takes_at_most_150_kb(make_trajectory: MakeTrajectory) -> None:
    sizes = []
    for seed in range(200):
        one = make_trajectory("magical/ClusterColour-TestAll-v0", steps=1, seed=seed)
        if len(one.scene.blocks) == 10:
            full = make_trajectory("magical/ClusterColour-TestAll-v0", steps=320, seed=seed)
            sizes.append(len(encode(full)))
        if len(sizes) == 2:
            break
    assert max(sizes) <= 150_000
    rng = np.random.default_rng(0)
    assert full.poses is not None
    noise = Trajectory.from_poses(
        full.env_id, full.scene, full.actions, rng.uniform(-1, 1, full.poses.shape)
    )
    assert len(encode(noise)) <= 150_000  # not even then


def test_open_read_filter(small_dataset: Path, make_trajectory: MakeTrajectory) -> None:
    dataset = Dataset.open(small_dataset)
    assert len(dataset) == 3
    assert_equal(dataset[0], make_trajectory(seed=1))
    assert_equal(dataset[-1], make_trajectory("magical/MoveToCorner-TestJitter-v0", seed=3))
    assert [t.seed for t in dataset] == [1, 2, 3]
    assert [t.seed for t in dataset[1:]] == [2, 3]
    with pytest.raises(IndexError):
        dataset[3]


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ({"task": "MoveToCorner"}, [1, 3]),
        ({"task": "MakeLine"}, []),
        ({"task": "MoveToCornr"}, "did you mean 'MoveToCorner'"),
        ({"variant": "TestAll"}, [2]),
        ({"variant": "Jitter"}, [3]),
        ({"variant": "demo"}, "not a variant"),
        ({"demonstrator": "other"}, [2]),
        ({"env_id": "MoveToCorner-Demo-LoRes4E-v0"}, [1]),
        ({"env_id": "MakeLine-Demo-v0"}, []),
        ({"env_id": "MoveToCornr-Demo-v0"}, "did you mean 'MoveToCorner'"),
        ({"min_score": 1.1}, []),
        ({"min_score": 0.0}, [1, 2, 3, 4]),
        ({"min_score": 0.9}, [4]),  # frames, of which only the published code's score is known
    ],
)
def test_filter(
    small_dataset: Path,
    make_frames_trajectory: MakeTrajectory,
    condition: dict[str, Any],
    expected: list[int] | str,
) -> None:
    DatasetWriter(small_dataset).append(make_frames_trajectory(seed=4, published_code_score=0.9))
    dataset = Dataset.open(small_dataset)
    if isinstance(expected, str):
        with pytest.raises(UnknownNameError, match=expected):
            dataset.filter(**condition)
    else:
        assert [entry.index + 1 for entry in dataset.filter(**condition).entries] == expected


def test_sample_depends_on_the_generator_alone(small_dataset: Path) -> None:
    dataset = Dataset.open(small_dataset)
    samples = [dataset.sample(2, np.random.default_rng(seed)).entries for seed in (0, 0, 1, 2, 3)]
    assert samples[0] == samples[1]
    assert len(set(samples)) > 1
    for sample in samples:
        assert [entry.index for entry in sample] == sorted(entry.index for entry in sample)
    with pytest.raises(DatasetError, match="expected 4 trajectories, found 3"):
        dataset.sample(4, np.random.default_rng(0))


APPEND_SOME = """
import sys
from magical.demos import Dataset, DatasetWriter
source, target, index = sys.argv[1:]
trajectory, writer = Dataset.open(source)[int(index)], DatasetWriter(target)
for _ in sys.stdin:
    writer.append(trajectory)
    print("appended", flush=True)
"""


def test_three_processes_append_at_once(tmp_path: Path, small_dataset: Path) -> None:
    path = tmp_path / "target"
    with ExitStack() as stack:
        jobs = [
            stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-c", APPEND_SOME, small_dataset, path, str(index)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )
            )
            for index in range(3)
        ]
        for _ in range(25):  # in each round all at once
            for job in jobs:
                assert job.stdin is not None
                job.stdin.write(b"\n")
                job.stdin.flush()
            for job in jobs:
                assert job.stdout is not None
                assert job.stdout.readline() == b"appended\n"
        for job in jobs:
            job.communicate()  # closes its input, which ends it
        assert [job.returncode for job in jobs] == [0, 0, 0]
    dataset = Dataset.open(path)
    assert [entry.index for entry in dataset.entries] == list(range(75))
    seeds = [t.seed or 0 for t in dataset]
    assert sorted(seeds) == [1] * 25 + [2] * 25 + [3] * 25
    assert seeds != sorted(seeds)  # they did take turns
    assert not Dataset.open(path, skip_damaged=True).problems


KILLED = """
import os, signal, sys
from pathlib import Path
from magical.demos import Dataset, DatasetWriter
Path.replace = lambda self, target: os.kill(os.getpid(), signal.SIGKILL)
DatasetWriter(sys.argv[2]).append(Dataset.open(sys.argv[1])[0])
"""


@pytest.mark.posix
def test_what_killed_writers_left_is_removed_by_the_next(
    tmp_path: Path, small_dataset: Path
) -> None:
    target, trajectory = tmp_path / "target", Dataset.open(small_dataset)[0]
    command = [sys.executable, "-c", KILLED, str(small_dataset), str(target)]
    for file in (".manifest.jsonl.*.part", "trajectories/.*.npz.*.part"):
        assert subprocess.run(command).returncode < 0
        assert len(list(target.glob(file))) == 1
        DatasetWriter(target).append(trajectory)
        assert not list(target.rglob("*.part"))
    assert len(Dataset.open(target)) == 2


def test_reading_many_needs_the_memory_of_one(
    tmp_path: Path, make_frames_trajectory: MakeTrajectory
) -> None:
    path = tmp_path / "dataset"
    writer = DatasetWriter(path)
    one = make_frames_trajectory(steps=9)
    for _ in range(40):
        writer.append(one)
    size = 2 * 10 * 96 * 96 * 3

    def peak(count: int) -> int:
        tracemalloc.start()
        total = sum(len(t) for t in Dataset.open(path)[:count])
        assert total == 9 * count
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    assert peak(40) < peak(2) + size / 2


def test_a_folder_with_something_else_is_no_dataset(tmp_path: Path) -> None:
    (tmp_path / "config.json").touch()
    with pytest.raises(DatasetError, match=r"found one with \['config.json'\]"):
        DatasetWriter(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["config.json"]


def test_a_folder_with_hidden_files_may_become_a_dataset(tmp_path: Path) -> None:
    (tmp_path / ".DS_Store").touch()
    assert len(Dataset.open(DatasetWriter(tmp_path).path)) == 0


def test_a_file_that_another_writer_has_renamed_meanwhile(tmp_path: Path) -> None:
    (tmp_path / ".manifest.jsonl.1a.part").symlink_to("gone")  # listed, and no file any more
    assert len(Dataset.open(DatasetWriter(tmp_path).path)) == 0
