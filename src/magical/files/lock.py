"""File locks between processes and threads; a process that ends or is killed releases its locks."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from magical.errors import MagicalError

LOCK = ".lock"  # the lock of a folder


@contextmanager
def owned(folder: Path, error: type[MagicalError], use: str) -> Iterator[None]:
    """Hold the lock of a folder, without waiting; the folder is created.

    Args:
        folder: the folder.
        error: the class of the error to raise if the lock is held elsewhere, or the disk is full.
        use: what the owner does, for the message, such as `trains this run`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / LOCK, timeout=0.1):
            yield
    except Timeout as problem:
        raise error(
            f"{folder}: another process already {use}; wait for it to end, or stop it"
        ) from problem
    except OSError as problem:
        if not is_out_of_space(problem):
            raise
        raise error(
            f"{folder}: no space left on the device. Finished files are intact: free some space, "
            "then run the same command again, with --resume if the run has begun"
        ) from problem


def is_locked(path: Path) -> bool:
    """Whether another process or thread holds the lock on a file."""
    if not path.exists():
        return False
    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True


def is_out_of_space(error: BaseException | None) -> bool:
    """Whether an error, or one that led to it, means that no space (or quota) is left."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__ or error.__context__
    return False
