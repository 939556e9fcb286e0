"""Run folders and their metrics as plain files; what entries state about their making."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from magical import runs
from magical.errors import RunFolderError
from magical.runs import (
    METRICS,
    read_metrics,
    track_of,
)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (b"{half", "expected JSON, found something else"),
        (b"[]", "expected object, found array"),
        (b'{"loss": 1}', "expected a step, found {'loss': 1}"),
        (b'{"step": 1, "loss": "\xff"}', "expected JSON, found something else"),
    ],
)
def test_a_damaged_line_is_named_and_one_cut_off_by_a_crash_left_out(
    tmp_path: Path, line: bytes, found: str
) -> None:
    assert read_metrics(tmp_path) == []
    (tmp_path / METRICS).write_bytes(b'{"step": 1, "loss": null}\n{"step')
    assert read_metrics(tmp_path) == [{"step": 1, "loss": None}]
    (tmp_path / METRICS).write_bytes(b'{"step": 1, "loss": null}\n' + line + b"\n")
    with pytest.raises(RunFolderError, match=re.escape(f"line 2: {found}")):
        read_metrics(tmp_path)


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_the_commit_is_that_of_the_source_if_it_is_tracked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> str:
        author = ("-c", "user.name=A", "-c", "user.email=a@b.c")
        command = ["git", *author, "-C", str(tmp_path), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    commit = runs.source_commit.__wrapped__
    file = tmp_path / "package" / "__init__.py"
    file.parent.mkdir()
    file.touch()
    monkeypatch.setattr(runs, "PACKAGE", str(file))
    assert commit() is None
    git("init", "-q")
    git("commit", "-q", "--allow-empty", "-m", "of another project")
    assert commit() is None
    git("add", ".")
    git("commit", "-q", "-m", "source")
    assert commit() == git("rev-parse", "HEAD")
    file.write_text("changed")
    assert commit() == f"{git('rev-parse', 'HEAD')}-dirty"


@pytest.mark.parametrize(
    ("used", "expected"),
    [
        (["demonstrations"], "P"),
        (["rendered states", "demonstrations"], "R"),
        (["demonstrations", "rendered states", "simulator"], "X"),
        (["demonstrations", "object parser"], "P"),
        (["demonstrations", "simulator", "benchmark prior"], "B"),
        (["benchmark prior"], ""),
        (["demonstrations", "interaction"], ""),
        (["simulator"], ""),
        ([], ""),
    ],
)
def test_the_track_follows_from_what_was_used(used: list[str], expected: str) -> None:
    assert track_of(used) == expected
