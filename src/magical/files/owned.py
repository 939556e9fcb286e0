"""Folders owned by one process at a time: their lock, their creation, and a full disk."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from magical.errors import MagicalError
from magical.files.atomic import is_partial, remove_partial_files
from magical.files.lock import LockedError, lock_now

LOCK = ".lock"


@dataclass(frozen=True)
class OwnedFolder:
    """A folder in which the holder of its lock writes; reading needs no lock.

    Attributes:
        path: the folder.
        files: the files that the owner writes in it, as patterns of `fnmatch`. The first exists
            from the folder's creation on: a folder with other files but not this one is refused.
        error: the class of the error to raise.
        use: what the owner does, for the message in another process, such as `trains this run`.
        advice: what to do once there is space again, for the message that the disk is full.
    """

    path: Path
    files: tuple[str, ...]
    error: type[MagicalError]
    use: str
    advice: str

    def exists(self) -> bool:
        """Whether the folder has been created."""
        return (self.path / self.files[0]).is_file()

    def require_new(self) -> None:
        """Raise unless the folder is missing, empty, or holds only what a killed creation left."""

        def unfinished(file: Path) -> bool:
            return file.name == LOCK or is_partial(file, self.files[0])

        path = self.path
        if path.is_symlink():
            raise self.error(
                f"{path}: expected a folder, found a symbolic link; give the folder itself"
            )
        if path.exists() and not (path.is_dir() and all(map(unfinished, path.iterdir()))):
            raise self.error(
                f"{path}: expected a new or an empty folder, found "
                f"{'other things in it' if path.is_dir() else 'a file'}; choose another one"
            )

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder's lock; a missing folder is created.

        Temporary files that killed owners left are removed.

        Raises:
            MagicalError: of the class `error`; another process or thread holds the lock, the folder
                holds other files, or the disk is full, on entry or in the block.
            OSError: any other error of the file system, on entry or in the block.
        """
        try:
            if self.path.is_symlink() or not self.exists():
                self.require_new()
            self.path.mkdir(parents=True, exist_ok=True)
            with lock_now(self.path / LOCK):
                remove_partial_files(self.path, *self.files)
                yield
        except LockedError as problem:
            raise self.error(
                f"{self.path}: process {problem.process_id or '(unknown)'} already {self.use}; "
                "wait for it to end, or stop it"
            ) from problem
        except OSError as problem:
            if not is_out_of_space(problem):
                raise
            raise self.error(
                f"{self.path}: no space left on the device. Finished files are intact: free some "
                f"space, then {self.advice}"
            ) from problem


def is_out_of_space(error: BaseException | None) -> bool:
    """Whether an error, or one that led to it, means that no space (or quota) is left."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__ or error.__context__
    return False
