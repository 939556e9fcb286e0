"""Appending trajectories to a dataset, each in its own transaction."""

import os
from pathlib import Path

from magical.demos.store import manifest
from magical.demos.store.dataset import stored_files
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.trajectory import Trajectory
from magical.errors import DatasetError
from magical.files import (
    LOCK,
    locked,
    make_folder,
    remove_partial_files,
    write_atomically,
)
from magical.messages import quoted


class DatasetWriter:
    """Appends to a dataset, created if it does not exist; several processes may append at once.

    Temporary files left by killed writers are removed.

    Raises:
        DatasetError: the folder contains other files, or cannot be written.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            self._create()
        except OSError as error:
            raise DatasetError(f"{self.path}: cannot be written: {error}") from error

    def append(self, trajectory: Trajectory) -> ManifestEntry:
        """Store a trajectory; on failure the dataset stays as it was.

        Raises:
            DatasetError: the disk is full, or the manifest is damaged; the message names the file.
            TrajectoryError: its metadata is too large for the format.
        """
        return self.append_encoded(*manifest.encoded(trajectory))

    def append_encoded(self, entry: ManifestEntry, raw: bytes) -> ManifestEntry:
        """As `append`, for an already encoded trajectory, such as one from another process."""
        try:
            with locked(self.path / LOCK):
                index, check = manifest.last_line(self.path)
                entry = entry.at(index)
                file = self.path / entry.file
                if os.path.lexists(file):
                    raise DatasetError(f"{file}: not in the manifest; {manifest.ADVICE}")
                self._store(file, raw, entry, check)
        except OSError as error:
            where = error.filename or self.path
            raise DatasetError(f"{where}: cannot be written: {error.strerror or error}") from error
        return entry

    def _store(self, file: Path, raw: bytes, entry: ManifestEntry, check: str) -> None:
        try:
            with write_atomically(file) as out:
                out.write(raw)
            manifest.append(self.path, entry, check)
        except BaseException:
            file.unlink(missing_ok=True)
            raise

    def _create(self) -> None:
        if self.path.is_dir() and (others := _others(self.path)):
            raise DatasetError(
                f"{self.path}: expected a dataset, or an empty or a new folder, found one with "
                f"{quoted(others)}"
            )
        make_folder(self.path / manifest.FOLDER)
        with locked(self.path / LOCK):  # held by all writers of these files
            found = stored_files(self.path)  # raises if their folder is a symbolic link
            remove_partial_files(self.path, manifest.NAME)
            remove_partial_files(self.path / manifest.FOLDER, "*.npz")
            if not (self.path / manifest.NAME).exists():
                if found:
                    raise DatasetError(
                        f"{self.path}: {manifest.NAME} is missing; {manifest.ADVICE}"
                    )
                with write_atomically(self.path / manifest.NAME) as file:
                    file.write(manifest.new_text([]).encode())


def _others(folder: Path) -> list[str]:
    """The names of files in a folder without a manifest that no writer has created.

    Hidden files do not count: file managers leave some, such as .DS_Store.
    """
    if (folder / manifest.NAME).exists():
        return []
    written = (manifest.FOLDER, manifest.NAME)  # perhaps just now, by another process
    names = (file.name for file in folder.iterdir())
    return sorted(name for name in names if name not in written and not name.startswith("."))
