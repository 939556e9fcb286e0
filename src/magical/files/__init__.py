"""Reading files of bounded size, and writing them whole or not at all; `lock` has file locks."""

import errno
import hashlib
import json
import os
import secrets
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from magical.errors import MagicalError
from magical.files.lock import LOCK, is_locked, is_out_of_space, owned

__all__ = [
    "LOCK",
    "is_locked",
    "is_out_of_space",
    "make_folder",
    "owned",
    "read_bounded",
    "reading",
    "remove_partial_files",
    "sha256_sum",
    "write_atomically",
    "write_json",
]

PAUSES = 0.01, 0.05, 0.2, 0.5  # seconds between attempts to replace a file, on Windows


@contextmanager
def write_atomically(path: Path | str) -> Iterator[IO[bytes]]:
    """Open a new file under a temporary name next to `path`; it is renamed if the block succeeds.

    Missing folders are created. If the block raises, nothing is left behind and an older file at
    `path` stays unchanged. If the machine crashes, the older or the new file is there, intact.
    """
    target = Path(path)
    make_folder(target.parent)
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        file = temporary.open("xb")  # x: never an existing file or link
        try:
            with file:
                yield file
            with temporary.open("r+b") as written:
                os.fsync(written.fileno())
            _replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        if error.errno and error.filename in (None, str(temporary)):
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise


def _replace(temporary: Path, target: Path) -> None:
    """Rename a file; Windows refuses while another process has the older one open, so retry."""
    for pause in PAUSES if sys.platform == "win32" else ():
        try:
            temporary.replace(target)
            return
        except PermissionError:
            time.sleep(pause)
    temporary.replace(target)


def write_json(path: Path, data: Mapping[str, Any], indent: int = 2) -> None:
    """Write a JSON object, indented, atomically."""
    with write_atomically(path) as file:
        file.write((json.dumps(data, indent=indent) + "\n").encode())


def make_folder(path: Path) -> None:
    """Create a folder and its parents, if they are missing; raises `OSError` if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise FileExistsError(f"{error.filename}: expected a folder, found a file") from error
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, "the folder cannot be written to", str(path))


def read_bounded(path: Path, max_bytes: int) -> bytes:
    """The contents of a file; raises `OSError` if it has more than `max_bytes`."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise OSError(errno.EFBIG, f"more than {max_bytes} bytes", str(path))
        return file.read(size)  # allocates as many bytes as are asked for, whatever there is


@contextmanager
def reading(path: Path | str, error: type[MagicalError]) -> Iterator[None]:
    """A context for reading a file: an `OSError` in it is raised as the class `error`."""
    try:
        yield
    except OSError as problem:
        name, found = problem.filename or path, problem.strerror or problem
        raise error(f"{name}: expected a readable file, found {found}") from problem


def sha256_sum(path: Path) -> str:
    """The SHA-256 sum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove_partial_files(folder: Path, *names: str) -> None:
    """Remove the temporary files of files with these names, left by killed processes."""
    for name in names:
        for file in folder.glob(f".{name}.*.part"):
            file.unlink(missing_ok=True)
