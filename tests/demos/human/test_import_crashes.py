"""A published file whose reading crashes costs that file alone."""

from pathlib import Path
from typing import Any

import pytest

from magical.demos import Dataset
from magical.demos.human.importing import import_published
from tests.demos import crashes
from tests.demos.conftest import Run

BAD = {
    "exit": "a worker process ended with exit status 3",
    "segfault": "a worker process was killed by signal 11 (SIGSEGV)",
    "memory": "MemoryError: no room",
}


@pytest.fixture
def files(tmp_path: Path, published: Any, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three good files and three whose reading fails, one after the other."""
    folder = tmp_path / "files"
    folder.mkdir()
    for i, name in enumerate(("a", "exit", "m", "memory", "n", "segfault", "z")):
        published(seed=i).write(folder / f"{name}.pkl.gz")
    monkeypatch.setattr("magical.demos.human.importing._convert", crashes.convert)
    return folder


@pytest.mark.posix
def test_a_crash_costs_one_file_which_is_named(files: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    status, result = run("import", files, "--out", out, "--workers", 2)
    reasons = {str(files / f"{name}.pkl.gz"): why for name, why in BAD.items()}
    assert status == 1
    assert dict(result["failed"]) == {file: f"{file}: {why}" for file, why in reasons.items()}
    good = [f"{name}.pkl.gz" for name in "amnz"]
    assert result["imported"] == good
    assert [entry.source for entry in Dataset.open(out).entries] == good


def test_a_file_that_crashes_can_be_mended_later(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = sorted(files.iterdir())[:3]
    first = import_published(paths, tmp_path / "out", workers=2)
    assert [Path(file).name for file, _ in first.failed] == ["exit.pkl.gz"]
    monkeypatch.undo()
    second = import_published(paths, tmp_path / "out", workers=1)
    assert (second.imported, second.failed) == (["exit.pkl.gz"], [])
