"""File locks between the processes and threads that share a dataset."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from magical.demos.store.regular_files import open_regular

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


@contextmanager
def locked(path: Path, *, reading: bool = False) -> Iterator[None]:
    """Hold a lock on the file `path`: exclusive, or with `reading` shared with other readers.

    Waits until the lock is free. A reader takes no lock where there is no lock file, as in a
    read-only copy.

    Raises:
        OSError: the lock file cannot be created, or is not a regular file.
    """
    if reading and not path.exists():
        yield
        return
    with open_regular(path, "rb" if reading else "ab") as file:
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
