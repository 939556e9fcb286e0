"""Files that several processes write and read.

- `atomic`: writing and linking under a temporary name, removing what killed processes left behind.
- `lock`: file locks.
- `owned`: folders that one process at a time writes to.
- `regular`: opening and reading regular files only.
"""

from magical.files.atomic import (
    is_partial,
    make_folder,
    remove_partial_files,
    write_atomically,
)
from magical.files.lock import LockedError, is_locked, lock_now, locked
from magical.files.owned import LOCK, OwnedFolder, is_out_of_space
from magical.files.regular import open_regular, read_regular, reading, sha256_sum

__all__ = [
    "LOCK",
    "LockedError",
    "OwnedFolder",
    "is_locked",
    "is_out_of_space",
    "is_partial",
    "lock_now",
    "locked",
    "make_folder",
    "open_regular",
    "read_regular",
    "reading",
    "remove_partial_files",
    "sha256_sum",
    "write_atomically",
]
