"""Atomic writing of files."""

import errno
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO

_PARTIAL = re.compile(r"\.(?P<name>.+)\.[0-9a-f]+\.part")  # the target's name, a random number
_FULL = errno.ENOSPC, errno.EDQUOT, errno.EFBIG  # of a write, whose error names no file
_PAUSES = 0.01, 0.05, 0.2, 0.5  # seconds, on Windows


@contextmanager
def write_atomically(path: Path | str) -> Iterator[IO[bytes]]:
    """Open a new file under a temporary name beside `path`, renamed to it if the block succeeds.

    Missing folders are made. If the block raises, nothing is left behind and an older file at
    `path` stays as it was. If the machine fails, the older file or the new one is there, whole.

    Raises:
        OSError: the folder cannot be made or written to, or the disk is full; names `path`.
    """
    target = Path(path)
    make_folder(target.parent)
    temporary = _temporary(target)
    try:
        file = temporary.open("xb")  # x: never a file or link that is there already
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
    """Make a folder and those above it, where they are missing.

    Raises:
        OSError: a folder cannot be made; a message of ours where something else is in its place.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        found = Path(error.filename)
        what = "a symbolic link to nothing" if found.is_symlink() else "a file"
        raise FileExistsError(f"{found}: expected a folder, found {what}") from error


def link_atomically(source: Path, target: Path) -> None:
    """Keep a file under a second name too; an older file at `target` is replaced.

    A hard link, or a copy on a file system without them. Neither may be changed in place later.

    Raises:
        OSError: the folder cannot be written to, or the disk is full.
    """
    temporary = _temporary(target)
    with _removed(temporary):
        try:
            temporary.hardlink_to(source)
        except OSError:
            with source.open("rb") as old, write_atomically(target) as new:
                shutil.copyfileobj(old, new)
        else:
            _replace(temporary, target)


def _replace(temporary: Path, target: Path) -> None:
    """Rename a file; Windows refuses that while another process has the older one open."""
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
    """Remove the temporary files that killed processes left when they wrote files to a folder.

    Args:
        folder: not searched if it is missing or a symbolic link; nor are folders in it.
        names: of the files that were written, as patterns of `fnmatch`. No other process may be
            writing a file of such a name: the caller holds the lock for that.
    """
    if folder.is_symlink() or not folder.is_dir():
        return
    for file in folder.iterdir():
        if is_partial(file, *names) and file.is_file():
            file.unlink(missing_ok=True)


def is_partial(file: Path, *names: str) -> bool:
    """Whether a file is a temporary one, for a file whose name matches one of the patterns."""
    found = _PARTIAL.fullmatch(file.name)
    return found is not None and any(fnmatchcase(found["name"], name) for name in names)
