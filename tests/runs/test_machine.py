"""What results may depend on: the machine, and the commit of the source."""

import shutil
import subprocess
from pathlib import Path

import pytest

from magical.runs import machine


def test_the_machine_is_described() -> None:
    found = machine.machine()
    assert set(found) == {"name", "platform", "processor", "cores"}
    assert all(found.values())
    assert int(found["cores"]) >= 1


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_the_commit_is_that_of_the_source_if_it_is_tracked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> str:
        author = ("-c", "user.name=A", "-c", "user.email=a@b.c")
        command = ["git", *author, "-C", str(tmp_path), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def commit() -> str | None:
        return machine.source_commit.__wrapped__()

    file = tmp_path / "package" / "__init__.py"
    file.parent.mkdir()
    file.touch()
    monkeypatch.setattr(machine, "PACKAGE", str(file))
    assert commit() is None
    git("init", "-q")
    git("commit", "-q", "--allow-empty", "-m", "of another project")
    assert commit() is None
    git("add", ".")
    git("commit", "-q", "-m", "source")
    assert commit() == git("rev-parse", "HEAD")
    file.write_text("changed")
    assert commit() == f"{git('rev-parse', 'HEAD')}-dirty"
