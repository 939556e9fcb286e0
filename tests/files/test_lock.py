"""Locks between processes and threads."""

import subprocess
import sys
from pathlib import Path

import pytest

from magical.errors import RunFolderError
from magical.files import LOCK, is_locked, owned

HOLD = """
import sys, pathlib
from magical.errors import RunFolderError
from magical.files import owned
with owned(pathlib.Path(sys.argv[1]), RunFolderError, "trains"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_held_folder_is_refused_at_once(tmp_path: Path) -> None:
    with owned(tmp_path / "a", RunFolderError, "trains this run"):
        assert is_locked(tmp_path / "a" / LOCK)
        message = "a: another process already trains this run; wait"
        with (
            pytest.raises(RunFolderError, match=message),
            owned(tmp_path / "a", RunFolderError, "trains this run"),
        ):
            pass
    with owned(tmp_path / "a", RunFolderError, ""), owned(tmp_path / "b", RunFolderError, ""):
        pass
    assert not is_locked(tmp_path / "a" / LOCK)


def test_a_killed_process_holds_no_lock(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        assert is_locked(tmp_path / LOCK)
        process.kill()
        process.wait()
        with owned(tmp_path, RunFolderError, "trains"):
            pass
