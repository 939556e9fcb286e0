"""Locks between processes (and threads) that share a dataset."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


@contextmanager
def locked(path: Path, *, reading: bool = False) -> Iterator[None]:
    """Hold the lock file `path`, alone or with other readers; waits for it.

    A reader goes without where there is no lock file, as in a copy that nobody writes to.
    Raises `OSError` if the file cannot be made.
    """
    if reading and not path.exists():
        yield
        return
    with path.open("rb" if reading else "ab") as file:
        _lock(file, reading)
        try:
            yield
        finally:
            _unlock(file)


if sys.platform == "win32":

    def _lock(file: IO[bytes], reading: bool) -> None:
        file.seek(0)
        msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)

    def _unlock(file: IO[bytes]) -> None:
        file.seek(0)
        msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)

else:

    def _lock(file: IO[bytes], reading: bool) -> None:
        fcntl.flock(file, fcntl.LOCK_SH if reading else fcntl.LOCK_EX)

    def _unlock(file: IO[bytes]) -> None:
        fcntl.flock(file, fcntl.LOCK_UN)
