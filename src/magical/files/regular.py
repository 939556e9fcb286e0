"""Opening regular files only: a device or FIFO under a file's name would block or never end."""

import errno
import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from magical.errors import MagicalError

_FLAGS = {
    "rb": os.O_RDONLY,
    "r+b": os.O_RDWR,
    "wb": os.O_WRONLY | os.O_CREAT,  # truncated after the check
    "ab": os.O_WRONLY | os.O_CREAT | os.O_APPEND,
}
# None of these exists on every platform; O_NONBLOCK keeps the opening of a FIFO from blocking.
_SAFE = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
_NO_LINKS = getattr(os, "O_NOFOLLOW", 0)


def open_regular(
    path: Path, mode: str = "rb", *, follow_links: bool = False, buffering: int = -1
) -> IO[bytes]:
    """Open a regular file.

    Args:
        path: the file.
        mode: `rb`, `r+b`, `wb` or `ab`.
        follow_links: accept a symbolic link to a regular file.
        buffering: as in `open`.

    Raises:
        OSError: it cannot be opened, is not a regular file or, unless `follow_links`, is a
            symbolic link.
    """
    if os.path.lexists(path):  # before opening: opening some devices has effects
        _check_regular(path.stat() if follow_links else path.lstat(), path)
    flags = _FLAGS[mode] | _SAFE | (0 if follow_links else _NO_LINKS)
    descriptor = os.open(path, flags, 0o666)
    try:
        _check_regular(os.fstat(descriptor), path)  # again: it may have been replaced
        if mode == "wb":
            os.ftruncate(descriptor, 0)
        return os.fdopen(descriptor, mode, buffering)
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: Path, max_bytes: int) -> bytes:
    """The contents of a regular file, or of one that a symbolic link leads to.

    Raises:
        OSError: it cannot be read, is not a regular file, or has more than `max_bytes`.
    """
    with open_regular(path, follow_links=True) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise OSError(errno.EFBIG, f"more than {max_bytes} bytes", str(path))
        return file.read(size)  # allocates as many bytes as are asked for, whatever there is


@contextmanager
def reading(path: Path, error: type[MagicalError]) -> Iterator[None]:
    """A context for reading a file: an `OSError` in it is raised as the class `error`."""
    try:
        yield
    except OSError as problem:
        name, found = problem.filename or path, problem.strerror or problem
        raise error(f"{name}: expected a readable file, found {found}") from problem


def sha256_sum(path: Path, *, follow_links: bool = False) -> str:
    """The SHA-256 sum of a file; arguments and errors as in `open_regular`."""
    with open_regular(path, follow_links=follow_links) as file:
        # `IO` does not declare `readinto`, which every file opened as binary has.
        return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]


def _check_regular(status: os.stat_result, path: Path) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "not a regular file", str(path))
