"""File locks between processes and threads; a process that ends or is killed releases its locks."""

import errno
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from magical.files.regular import open_regular

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_DIGITS = 20  # the most digits of a process id that are read
PAUSES = 0.01, 0.05  # seconds between attempts: `is_locked` elsewhere briefly holds a lock


class LockedError(Exception):
    """A lock is held elsewhere.

    Attributes:
        process_id: the holder's, if it is known.
    """

    def __init__(self, process_id: int | None) -> None:
        super().__init__(process_id)
        self.process_id = process_id


@contextmanager
def locked(path: Path, *, reading: bool = False) -> Iterator[None]:
    """Hold a lock on the file `path`: exclusive, or with `reading` shared with other readers.

    Waits until the lock is free. A reader takes no lock if there is no lock file, as in a read-only
    copy, or if the file system has no locks.

    Raises:
        OSError: the lock file cannot be created, is not a regular file, or cannot be locked.
    """
    if reading and not path.exists():
        yield
        return
    with open_regular(path, "rb" if reading else "ab") as file:
        _lock(file, path, reading=reading, wait=True)
        try:
            yield
        finally:
            _unlock(file)


@contextmanager
def lock_now(path: Path) -> Iterator[None]:
    """Hold an exclusive lock on the file `path`, without waiting, and write the process id to it.

    Raises:
        LockedError: another process or thread holds it.
        OSError: the lock file cannot be created, is not a regular file, or cannot be locked.
    """
    with open_regular(path, "ab") as file:
        for pause in (*PAUSES, None):
            try:
                _lock(file, path, reading=False, wait=False)
                break
            except (BlockingIOError, PermissionError) as error:  # on Windows the latter
                if pause is None:
                    raise LockedError(_holder(path)) from error
                time.sleep(pause)
        try:
            file.truncate(0)
            file.write(str(os.getpid()).encode())
            file.flush()
            yield
        finally:
            _unlock(file)


def is_locked(path: Path) -> bool:
    """Whether another process, or an open file of this one, holds an exclusive lock on a file.

    Always false if the file system has no locks.

    Raises:
        OSError: the file cannot be opened, or is not a regular file.
    """
    if not path.exists():
        return False
    with open_regular(path) as file:
        try:
            _lock(file, path, reading=True, wait=False)
        except (BlockingIOError, PermissionError):
            return True
        _unlock(file)
        return False


def _holder(path: Path) -> int | None:
    """The process id in a lock file; `None` if it has not been written yet."""
    with open_regular(path) as file:
        text = file.read(_DIGITS)
    return int(text) if text.isdigit() else None


if sys.platform == "win32":
    _LOCKED_BYTE = 1 << 30  # beyond the contents, so that others can read them

    def _lock(file: IO[bytes], path: Path, *, reading: bool, wait: bool) -> None:
        while True:
            file.seek(_LOCKED_BYTE)
            try:
                msvcrt.locking(file.fileno(), msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
            except OSError as error:
                if not wait or error.errno != errno.EDEADLOCK:  # it gives up after ten seconds
                    raise
            else:
                return

    def _unlock(file: IO[bytes]) -> None:
        file.seek(_LOCKED_BYTE)
        msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)

else:
    # Errors of file systems without locks: some network file systems, depending on their mount.
    _NO_LOCKS = errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP

    def _lock(file: IO[bytes], path: Path, *, reading: bool, wait: bool) -> None:
        kind = fcntl.LOCK_SH if reading else fcntl.LOCK_EX
        try:
            fcntl.flock(file, kind if wait else kind | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            if not reading:
                problem = "expected a file system with file locks, found none; use another folder"
                raise OSError(error.errno, problem, str(path)) from error

    def _unlock(file: IO[bytes]) -> None:
        with suppress(OSError):  # there was no lock; closing the file releases one anyway
            fcntl.flock(file, fcntl.LOCK_UN)
