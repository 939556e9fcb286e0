"""Only regular files of bounded size are read."""

import os
import tracemalloc
from pathlib import Path

import pytest

from magical.files import open_regular, read_regular


def special(folder: Path, name: str) -> Path:
    """A path that never ends, blocks, or is no file."""
    path = folder / "special"
    match name:
        case "FIFO":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "dangling link":
            path.symlink_to("nowhere")
        case device:
            path.symlink_to(device)
    return path


POSIX = [pytest.param(name, marks=pytest.mark.posix) for name in ("FIFO", "/dev/zero", "/dev/null")]


@pytest.mark.parametrize("name", ["folder", "dangling link", *POSIX])
def test_special_files_are_refused(tmp_path: Path, name: str) -> None:
    path = special(tmp_path, name)
    with pytest.raises(OSError, match="special"):
        read_regular(path, 10)
    with pytest.raises(OSError, match="special"):
        open_regular(path)


def test_no_more_memory_is_taken_than_a_file_has_bytes(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"0123456789")
    tracemalloc.start()
    try:
        assert read_regular(tmp_path / "file", 1 << 26) == b"0123456789"
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_links_are_followed_for_reading_alone(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "file").write_bytes(b"0123456789")
    assert read_regular(tmp_path / "link", 10) == b"0123456789"
    for mode in ("rb", "r+b", "wb", "ab"):
        with pytest.raises(OSError, match="link"):
            open_regular(tmp_path / "link", mode)
    assert (tmp_path / "file").read_bytes() == b"0123456789"


def test_larger_files_are_refused(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(OSError, match="more than 10 bytes"):
        read_regular(tmp_path / "sparse", 10)
