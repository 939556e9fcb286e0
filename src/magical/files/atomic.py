"""Atomic writing of files."""

import errno
import os
import re
import secrets
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO

_PARTIAL = re.compile(r"\.(?P<name>.+)\.[0-9a-f]+\.part")  # the target's name, a random number
_FULL = errno.ENOSPC, errno.EDQUOT, errno.EFBIG  # errors of a write that name no file
_PAUSES = 0.01, 0.05, 0.2, 0.5  # seconds between attempts, on Windows


@contextmanager
def write_atomically(path: Path | str) -> Iterator[IO[bytes]]:
    """Open a new file under a temporary name next to `path`; it is renamed if the block succeeds.

    Missing folders are created. If the block raises, nothing is left behind and an older file at
    `path` stays unchanged. If the machine crashes, the older or the new file is there, intact.

    Raises:
        OSError: the folder cannot be created or written to, or the disk is full; the error names
            `path`.
    """
    target = Path(path)
    make_folder(target.parent)
    temporary = _temporary(target)
    try:
        file = temporary.open("xb")  # x: never an existing file or link
        with _removed(temporary), file:
            yield file
            file.close()
            with temporary.open("r+b") as whole:
                os.fsync(whole.fileno())
            _replace(temporary, target)
    except OSError as error:
        unnamed = error.filename is None and error.errno in _FULL
        if unnamed or error.filename == str(temporary):
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise


def make_folder(path: Path) -> None:
    """Create a folder and its parents, if they are missing.

    Raises:
        OSError: a folder cannot be created, or not be written to; if something else is in its
            place, the message says so.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        found = Path(error.filename)
        what = "a broken symbolic link" if found.is_symlink() else "a file"
        raise FileExistsError(f"{found}: expected a folder, found {what}") from error
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, "the folder cannot be written to", str(path))


def _replace(temporary: Path, target: Path) -> None:
    """Rename a file; Windows refuses while another process has the older one open, so retry."""
    for pause in _PAUSES if sys.platform == "win32" else ():
        try:
            temporary.replace(target)
        except PermissionError:
            time.sleep(pause)
        else:
            return
    temporary.replace(target)


def _temporary(target: Path) -> Path:
    if not target.name:
        raise IsADirectoryError(errno.EISDIR, "expected the path of a file, found", str(target))
    return target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")


@contextmanager
def _removed(temporary: Path) -> Iterator[None]:
    try:
        yield
    finally:
        temporary.unlink(missing_ok=True)


def remove_partial_files(folder: Path, *names: str) -> None:
    """Remove the temporary files left by processes that were killed while writing to a folder.

    Args:
        folder: not searched if it is missing or a symbolic link; nor are its subfolders.
        names: the names of the files that were written, as patterns of `fnmatch`. No other process
            may be writing a file with such a name: the caller holds the lock for that.
    """
    if folder.is_symlink() or not folder.is_dir():
        return
    for file in folder.iterdir():
        if is_partial(file, *names) and file.is_file():
            file.unlink(missing_ok=True)


def is_partial(file: Path, *names: str) -> bool:
    """Whether a file is the temporary one of a file whose name matches one of the patterns."""
    found = _PARTIAL.fullmatch(file.name)
    return found is not None and any(fnmatchcase(found["name"], name) for name in names)
