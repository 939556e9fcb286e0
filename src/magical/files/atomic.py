"""Atomic writing of files."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO

_PARTIAL = re.compile(r"\.(?P<name>.+)\.\d+\.part")  # the target's name and a process id


@contextmanager
def write_atomically(path: Path | str) -> Iterator[IO[bytes]]:
    """Open a file under a temporary name beside `path`, renamed to it if the block succeeds.

    Missing folders are made. If the block raises, nothing is left behind and an older file at
    `path` stays as it was.

    Raises:
        OSError: the folder cannot be made or written to, or the disk is full.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with temporary.open("wb") as file:
            yield file
        temporary.replace(target)
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
        found = _PARTIAL.fullmatch(file.name)
        if found and file.is_file() and any(fnmatchcase(found["name"], name) for name in names):
            file.unlink(missing_ok=True)
