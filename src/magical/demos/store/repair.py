"""Rebuilding the manifest of a damaged dataset."""

import hashlib
import itertools
import os
import re
from pathlib import Path

from magical.demos.store import manifest
from magical.demos.store.codec import MAX_FILE, decode
from magical.demos.store.dataset import Dataset, Problem, read_file, read_manifest, stored_files
from magical.demos.store.manifest import ManifestEntry
from magical.errors import DatasetError, UnknownNameError
from magical.files import LOCK, locked, write_atomically


def repair(path: Path | str) -> list[Problem]:
    """Rebuild the manifest from the intact trajectory files; returns the problems found.

    Damaged trajectory files are moved to the folder `damaged`. Files that match the manifest are
    kept even if their task is not registered, or no longer allows their scene.

    Raises:
        DatasetError: there is no dataset; a file cannot be read, or it belongs to an unregistered
            task and does not match the manifest. Nothing is changed then.
        OSError: the dataset cannot be written.
    """
    folder = Path(path)
    if not (folder / manifest.FOLDER).is_dir():
        raise DatasetError(f"{folder}: expected a dataset, found no {manifest.FOLDER} in it")
    with locked(folder / LOCK):
        try:
            entries, problems = read_manifest(folder)
        except DatasetError as error:
            entries, problems = [], [Problem(str(folder / manifest.NAME), str(error))]
        listed = {entry.file: entry for entry in entries}
        kept, damaged, files = [], [], stored_files(folder)
        for name in sorted(listed.keys() - {f"{manifest.FOLDER}/{file.name}" for file in files}):
            problems.append(Problem(str(folder / name), "is missing"))
        for file in files:
            raw = _read(file)
            try:
                kept.append(entry := _recovered(folder, file, raw, listed))
                if listed.get(entry.file, entry) != entry:
                    problems.append(Problem(str(file), "the manifest described another one"))
            except DatasetError as error:
                if isinstance(error.__cause__, UnknownNameError):
                    raise DatasetError(
                        f"{file}: {error.__cause__}; import the module that registers its task"
                    ) from error
                problems.append(Problem(str(file), str(error)))
                damaged.append(file)
        for file in damaged:
            _set_aside(file, folder / "damaged")
        with write_atomically(folder / manifest.NAME) as out:
            out.write(manifest.new_text(kept).encode())
    return problems


def open_repaired(path: Path | str) -> Dataset:
    """Open a dataset, repairing it first if it is damaged, as by a kill during an append.

    Raises the errors of `repair`.
    """
    try:
        return Dataset.open(path)
    except DatasetError:
        repair(path)
        return Dataset.open(path)


def _set_aside(file: Path, damaged: Path) -> None:
    """Move a damaged file to the folder `damaged`, under a name that is free there."""
    if damaged.is_symlink():
        raise DatasetError(f"{damaged}: expected a folder of the dataset, found a symbolic link")
    damaged.mkdir(exist_ok=True)
    names = itertools.chain([file.name], (f"{file.name}.{i}" for i in itertools.count(1)))
    free = next(name for name in names if not os.path.lexists(damaged / name))
    file.rename(damaged / free)


def _read(file: Path) -> bytes | None:
    """A file's bytes; None if it is not a trajectory's. Raises `DatasetError` if unreadable."""
    try:
        return read_file(file)
    except DatasetError as error:
        if isinstance(error.__cause__, OSError) and file.is_file() and not file.is_symlink():
            raise
        return None


def _recovered(
    folder: Path, file: Path, raw: bytes | None, listed: dict[str, ManifestEntry]
) -> ManifestEntry:
    if raw is None:
        raise DatasetError(f"{file}: expected a regular file of at most {MAX_FILE} bytes")
    known = listed.get(f"{manifest.FOLDER}/{file.name}")
    unchanged = known is not None and known.sha256 == hashlib.sha256(raw).hexdigest()
    number = re.match(r"\d{1,9}(?=-)", file.name)
    try:
        entry = ManifestEntry.of(decode(raw), raw, int(number[0]) if number else 0)
    except DatasetError:
        if known and unchanged:
            return known
        raise
    except ValueError as error:
        raise DatasetError(f"{file}: cannot be listed in a manifest: {error}") from error
    if folder / entry.file != file:
        raise DatasetError(f"{file}: expected the name {entry.file}")
    if known and not unchanged:
        raise DatasetError(f"{file}: the file was changed after it was written")
    return entry
