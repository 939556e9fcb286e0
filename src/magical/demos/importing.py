"""Importing the published human demonstrations into a dataset."""

import hashlib
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from magical.demos.codec import encode
from magical.demos.dataset import Dataset
from magical.demos.manifest import Entry
from magical.demos.published import MAX_UNPACKED, read_published
from magical.demos.writer import DatasetWriter
from magical.errors import DatasetError, MagicalError, WorkerError
from magical.processes import available_cores, map_in_processes

SUFFIX = ".pkl.gz"
Progress = Callable[[int], None]  # is told how many files have just been dealt with


@dataclass(frozen=True, slots=True)
class ImportReport:
    """What became of the files, by their names."""

    imported: tuple[str, ...]
    already: tuple[str, ...]  # were in the dataset before
    duplicates: tuple[tuple[str, str], ...]  # (file, earlier one with the same actions and frames)
    failed: tuple[tuple[str, str], ...]  # (file, why)


def find_published(source: Path) -> list[Path]:
    """The published files in a folder and its subfolders, or the one file.

    Raises `DatasetError` if there are none.
    """
    found = sorted(source.rglob(f"*{SUFFIX}")) if source.is_dir() else [source]
    if not found or not found[0].is_file():
        raise DatasetError(f"{source}: expected files *{SUFFIX}, found none")
    return found


def import_published(
    files: Sequence[Path],
    out: Path | str,
    *,
    workers: int | None = None,
    max_bytes: int = MAX_UNPACKED,
    skip_duplicates: bool = False,
    progress: Progress | None = None,
) -> ImportReport:
    """Append published files to a dataset, in their order; one bad file does not stop the rest.

    Files of the same name and bytes that are in the dataset already are left alone. Those with the
    same actions and frames as another are imported, unless `skip_duplicates`, and reported.

    Raises:
        DatasetError: the dataset cannot be written; what was imported before stays.
    """
    writer, entries = DatasetWriter(out), Dataset.open(out).entries
    known = {(entry.source, entry.source_sha256) for entry in entries}
    first = {entry.fingerprint: entry.source or entry.file for entry in entries}
    wanted = [file for file in files if (file.name, _sum(file)) not in known]
    already = [file.name for file in files if file not in set(wanted)]
    tell = progress or (lambda _: None)
    tell(len(already))
    imported, duplicates, failed = [], [], []
    workers = min(workers or available_cores(), len(wanted))
    convert = partial(_convert, max_bytes=max_bytes)
    with closing(map_in_processes(convert, wanted, workers, on_error="return")) as results:
        for file, result in zip(wanted, results, strict=True):
            tell(1)
            if isinstance(result, Exception):
                failed.append((str(file), _reason(file, result)))
                continue
            earlier = first.setdefault(result[0].fingerprint, file.name)
            if earlier != file.name:
                duplicates.append((file.name, earlier))
                if skip_duplicates:
                    continue
            writer.append_encoded(*result)
            imported.append(file.name)
    return ImportReport(tuple(imported), tuple(already), tuple(duplicates), tuple(failed))


def _sum(file: Path) -> str:
    """The file's SHA-256, or nothing where it cannot be read: reading it again will say why."""
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError:
        return ""


def _convert(file: Path, max_bytes: int) -> tuple[Entry, bytes]:
    trajectory = read_published(file, max_bytes)
    raw = encode(trajectory)
    return Entry.of(trajectory, raw), raw


def _reason(file: Path, error: Exception) -> str:
    """Why a file failed, with its name; little of a text that may be the file's."""
    if isinstance(error, MagicalError) and not isinstance(error, WorkerError):
        return str(error) if str(file) in str(error) else f"{file}: {error}"
    return f"{file}: {type(error).__name__}: {str(error)[:200]!r}"
