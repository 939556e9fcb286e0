"""Damage is detected and named, the rest stays usable, and writes are atomic."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
import pytest

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.demos.store import manifest
from magical.demos.store.repair import repair
from magical.errors import DatasetError, InvalidSceneError, UnknownNameError
from magical.files import write_atomically
from tests.demos.conftest import MakeTrajectory


def flipped(raw: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(raw)))
    return raw[:place] + bytes([raw[place] ^ (1 << int(rng.integers(8)))]) + raw[place + 1 :]


def stored_files(path: Path) -> list[Path]:
    return [path / "manifest.jsonl", *sorted((path / "trajectories").iterdir())]


def test_every_flip_and_truncation_is_detected(small_dataset: Path) -> None:
    rng = np.random.default_rng(0)
    for trial in range(240):
        file = stored_files(small_dataset)[trial % 4]
        raw = file.read_bytes()
        file.write_bytes(flipped(raw, rng) if trial % 3 else raw[: int(rng.integers(len(raw)))])
        problems = Dataset.open(small_dataset, skip_damaged=True).problems
        assert any(problem.file == str(file) for problem in problems) or (
            file.name == "manifest.jsonl" and problems
        ), f"trial {trial}: {file} undetected"
        with pytest.raises(DatasetError, match=r"trajectories|manifest"):
            list(Dataset.open(small_dataset))
        file.write_bytes(raw)
    assert not Dataset.open(small_dataset, skip_damaged=True).problems


@pytest.mark.parametrize("damage", ["flip", "cut", "missing", "swapped"])
def test_rest_of_a_damaged_dataset_is_usable(small_dataset: Path, damage: str) -> None:
    _, first, second, _ = stored_files(small_dataset)
    if damage == "flip":
        second.write_bytes(flipped(second.read_bytes(), np.random.default_rng(0)))
    elif damage == "cut":
        second.write_bytes(second.read_bytes()[:-100])
    elif damage == "missing":
        second.unlink()
    else:
        second.write_bytes(first.read_bytes())
    dataset = Dataset.open(small_dataset)
    messages = {"missing": "a readable file", "cut": "found [0-9]+; the file was changed"}
    with pytest.raises(DatasetError, match=messages.get(damage, "SHA-256|found [0-9]+; the file")):
        dataset[1]
    assert [dataset[i].seed for i in (0, 2)] == [1, 3]
    rest = Dataset.open(small_dataset, skip_damaged=True)
    assert [t.seed for t in rest] == [1, 3]
    assert [problem.file for problem in rest.problems] == [str(second)]


@pytest.mark.parametrize(
    ("cut", "message"), [(1, "line 4"), (40, "line 4"), (700, "line 3"), (None, "TestJitter")]
)
def test_manifest_cut_off_is_detected_and_repaired(
    small_dataset: Path, cut: int | None, message: str
) -> None:
    manifest = small_dataset / "manifest.jsonl"
    raw = manifest.read_bytes()
    manifest.write_bytes(raw[:-cut] if cut else raw[: raw.rindex(b"\n", 0, -1) + 1])
    with pytest.raises(DatasetError, match=rf"{message}.*--repair"):
        Dataset.open(small_dataset)
    if cut:
        with pytest.raises(DatasetError, match="last line is damaged"):
            DatasetWriter(small_dataset).append(Dataset.open(small_dataset, skip_damaged=True)[0])
    assert repair(small_dataset)
    assert [t.seed for t in Dataset.open(small_dataset)] == [1, 2, 3]
    assert not Dataset.open(small_dataset, skip_damaged=True).problems


def test_repair_names_files_that_are_missing(small_dataset: Path) -> None:
    (_, first, *_) = stored_files(small_dataset)
    first.unlink()
    (problem,) = repair(small_dataset)
    assert (problem.file, problem.what) == (str(first), "is missing")
    assert len(Dataset.open(small_dataset)) == 2


def test_repair_moves_damaged_files(small_dataset: Path) -> None:
    second = stored_files(small_dataset)[2]
    raw = second.read_bytes()
    second.write_bytes(raw[: len(raw) // 2])
    (small_dataset / "manifest.jsonl").unlink()
    assert [problem.file for problem in repair(small_dataset)][-1] == str(second)
    assert [t.seed for t in Dataset.open(small_dataset)] == [1, 3]
    assert (small_dataset / "damaged" / second.name).exists()
    with pytest.raises(DatasetError, match="expected a dataset"):
        repair(small_dataset / "missing")


def test_a_line_that_describes_another_trajectory_is_made_anew(small_dataset: Path) -> None:
    first, *others = before = Dataset.open(small_dataset).entries
    wrong = [replace(first, score=0.125), *others]
    (small_dataset / "manifest.jsonl").write_text(manifest.new_text(wrong))
    with pytest.raises(DatasetError, match=r"describes another one.*--repair"):
        Dataset.open(small_dataset)[0]
    (problem,) = repair(small_dataset)
    assert str(problem) == f"{small_dataset / first.file}: the manifest described another one"
    assert Dataset.open(small_dataset).entries == before


REFUSED = {
    "not registered": UnknownNameError("unknown task 'Mine'"),
    "by now of other scenes": InvalidSceneError("at most 3 blocks"),
}


def refuse(monkeypatch: pytest.MonkeyPatch, cause: str) -> None:
    """Let no trajectory be decoded, since its task is what the cause says."""

    def decode(raw: bytes) -> Trajectory:
        raise DatasetError("another file") from REFUSED[cause]

    monkeypatch.setattr("magical.demos.store.repair.decode", decode)


@pytest.mark.parametrize("cause", REFUSED)
def test_listed_files_are_kept_whatever_their_task_is_now(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch, cause: str
) -> None:
    before = Dataset.open(small_dataset).entries
    refuse(monkeypatch, cause)
    assert repair(small_dataset) == []
    assert Dataset.open(small_dataset).entries == before
    assert not (small_dataset / "damaged").exists()


def test_unlisted_files_of_a_task_that_is_not_registered_are_left_where_they_are(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse(monkeypatch, "not registered")
    (small_dataset / "manifest.jsonl").unlink()
    with pytest.raises(DatasetError, match="unknown task 'Mine'; import the module"):
        repair(small_dataset)
    assert not (small_dataset / "damaged").exists()


def test_files_that_cannot_be_read_now_are_not_set_aside(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(path: Path) -> bytes:
        raise DatasetError(f"{path}: cannot be read") from OSError(5, "Input/output error")

    monkeypatch.setattr("magical.demos.store.repair.read_file", unreadable)
    with pytest.raises(DatasetError, match="cannot be read"):
        repair(small_dataset)
    assert not (small_dataset / "damaged").exists()


def fill(file: IO[bytes], data: bytes) -> None:
    """Write half on a disk that is then full."""
    file.write(data[: len(data) // 2])
    raise OSError(28, "No space left on device")


@contextmanager
def full(path: Path) -> Iterator[Any]:
    with write_atomically(path) as file:
        yield SimpleNamespace(write=partial(fill, file))


def test_full_disk_leaves_no_partial_files(
    small_dataset: Path, make_trajectory: MakeTrajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path: path.read_bytes() for path in small_dataset.rglob("*") if path.is_file()}
    writer = DatasetWriter(small_dataset)
    for name, failing in (("writer.write_atomically", full), ("manifest._write_all", fill)):
        monkeypatch.setattr(f"magical.demos.store.{name}", failing)
        with pytest.raises(DatasetError, match="No space left"):
            writer.append(make_trajectory())
        monkeypatch.undo()
    assert {p: p.read_bytes() for p in small_dataset.rglob("*") if p.is_file()} == before
    writer.append(make_trajectory(seed=9))
    assert [t.seed for t in Dataset.open(small_dataset)] == [1, 2, 3, 9]


LIMITED = """
import resource, signal, sys
from magical.cli import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.linux
def test_command_on_a_full_disk_exits_with_1(tmp_path: Path, published: Any) -> None:
    file = published().write(tmp_path / "demo.pkl.gz")
    out = tmp_path / "out"
    command = ["demos", "import", str(file), "--out", str(out), "--workers", "1"]
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, *command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list((out / "trajectories").iterdir())
    assert len(Dataset.open(out)) == 0


@pytest.mark.posix
def test_dataset_without_write_permission_can_be_read(small_dataset: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    for path in (small_dataset, small_dataset / ".lock"):
        path.chmod(0o555)
    assert len(list(Dataset.open(small_dataset))) == 3
