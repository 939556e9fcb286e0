"""Atomic writing of files."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


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
