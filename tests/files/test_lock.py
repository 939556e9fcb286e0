"""Locks between processes and threads."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from magical.files import LockedError, is_locked, lock_now, locked

HOLD = """
import sys, pathlib
from magical.files import lock_now
with lock_now(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_held_lock_is_refused_at_once_and_names_the_process(tmp_path: Path) -> None:
    with lock_now(tmp_path / "lock"):
        with pytest.raises(LockedError) as refused, lock_now(tmp_path / "lock"):
            pass
        assert refused.value.process_id == os.getpid()
    with lock_now(tmp_path / "lock"), locked(tmp_path / "another"):
        pass


def test_a_killed_process_holds_no_lock(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path / "lock")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(LockedError) as refused, lock_now(tmp_path / "lock"):
            pass
        assert refused.value.process_id == process.pid
        process.kill()
        process.wait()
        with lock_now(tmp_path / "lock"):
            assert (tmp_path / "lock").read_text() == str(os.getpid())


def test_a_lock_whose_holder_is_unknown_is_refused_too(tmp_path: Path) -> None:
    with locked(tmp_path / "lock"):  # writes no process id
        with pytest.raises(LockedError) as refused, lock_now(tmp_path / "lock"):
            pass
        assert refused.value.process_id is None


@pytest.mark.posix
def test_a_file_system_without_locks_can_be_read_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    lock = tmp_path / "lock"
    lock.touch()
    monkeypatch.setattr("fcntl.flock", unsupported)
    with locked(lock, reading=True):
        assert not is_locked(lock)
    for holding in (locked, lock_now):
        with pytest.raises(OSError, match=rf"a file system with file locks.*{lock}"), holding(lock):
            pass
