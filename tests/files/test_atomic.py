"""Writing in one go."""

import errno
import os
import re
import secrets
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from magical.files import write_atomically


def test_a_file_appears_whole_in_a_new_folder(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b.bin"
    with write_atomically(path) as file:
        file.write(b"half")
        assert not path.exists()
        file.write(b"whole")
    assert path.read_bytes() == b"halfwhole"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ("file/x.json", "file: expected a folder, found a file"),
    ],
)
def test_a_folder_that_is_something_else_is_named(tmp_path: Path, path: str, what: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=re.escape(what)), write_atomically(tmp_path / path):
        pass


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(b"old")

    def fail() -> None:
        with write_atomically(path) as file:
            file.write(b"new")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_names_the_file_that_was_to_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.bin"

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")  # as of a write: without a name

    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="dir") as refused, write_atomically(tmp_path / "folder"):
        pass
    assert refused.value.filename == str(tmp_path / "folder")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space") as refused, write_atomically(path):
        pass
    assert refused.value.filename == str(path)


def test_windows_is_asked_again_while_a_reader_has_the_older_file_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, replace, refusals = tmp_path / "x.bin", Path.replace, [1, 2]

    def refused_twice(self: Path, target: Path) -> Path:
        if refusals:
            refusals.pop()
            raise PermissionError
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", refused_twice)
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr("time.sleep", lambda _: None)
    with write_atomically(path) as file:
        file.write(b"new")
    assert path.read_bytes() == b"new"


def test_the_file_has_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    with write_atomically(tmp_path / "careful"):
        pass
    assert (tmp_path / "careful").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_two_threads_may_write_one_file(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"

    def write(number: int) -> None:
        with write_atomically(path) as file:
            file.write(bytes([number]) * 1000)
            file.flush()
            file.write(bytes([number]) * 1000)

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(write, range(100)))
    assert path.read_bytes() in [bytes([number]) * 2000 for number in range(100)]
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_planted_under_the_temporary_name_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(secrets, "token_hex", lambda size: "ab" * size)
    (tmp_path / "mine").write_text("mine")
    link = tmp_path / ".x.bin.abababab.part"
    link.symlink_to("mine")
    with pytest.raises(FileExistsError), write_atomically(tmp_path / "x.bin"):
        pass
    assert link.is_symlink()
    assert (tmp_path / "mine").read_text() == "mine"
