"""Importing the published human demonstrations into a dataset."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from magical.demos.human.published import MAX_UNPACKED, read_published
from magical.demos.processes import in_processes, usable_cores
from magical.demos.store.codec import encode
from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.regular_files import open_regular
from magical.demos.store.writer import DatasetWriter
from magical.errors import DatasetError, MagicalError

SUFFIX = ".pkl.gz"
Progress = Callable[[int], None]  # called with the number of files finished since the last call
_Result = tuple[ManifestEntry, bytes] | MagicalError


@dataclass(frozen=True, slots=True)
class ImportReport:
    """Names of the files, by outcome of the import."""

    imported: tuple[str, ...]
    already: tuple[str, ...]  # in the dataset before
    duplicates: tuple[tuple[str, str], ...]  # (file, earlier one with the same actions and frames)
    failed: tuple[tuple[str, str], ...]  # (file, reason)


def find_published(source: Path) -> list[Path]:
    """The published files in a folder and its subfolders, or the one file.

    Raises:
        DatasetError: there are none.
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
    sums: Mapping[Path, str] | None = None,
    progress: Progress | None = None,
) -> ImportReport:
    """Append published files to a dataset, in their order; a bad file does not stop the others.

    Files of the same name and bytes that are already in the dataset are skipped.

    Args:
        files: the published files.
        out: the dataset, created if there is none.
        workers: number of processes; default: the usable cores.
        max_bytes: the most that one file may unpack to.
        skip_duplicates: leave out files with the same actions and frames as an earlier one, which
            are otherwise imported and reported.
        sums: the SHA-256 sum of every file; a file with another one is not imported.
        progress: called with the number of files finished since the last call.

    Raises:
        DatasetError: the dataset cannot be written; what was imported before stays.
    """
    writer, entries = DatasetWriter(out), Dataset.open(out).entries
    known = {(entry.source, entry.source_sha256) for entry in entries}
    first = {entry.fingerprint: entry.source or entry.file for entry in entries}
    wanted = [file for file in files if (file.name, _sum(file)) not in known]
    already = [file.name for file in files if file not in set(wanted)]
    advance = progress or (lambda _: None)
    advance(len(already))
    imported, duplicates, failed = [], [], []
    workers = min(workers or usable_cores(), len(wanted))
    results = in_processes(partial(_convert, max_bytes=max_bytes), wanted, workers)
    for file, result in zip(wanted, results, strict=True):
        advance(1)
        problem = _problem(file, result, sums)
        if problem or isinstance(result, MagicalError):
            failed.append((str(file), problem))
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
    """The file's SHA-256; empty where it cannot be read, which reading it later reports."""
    try:
        with open_regular(file, follow_links=True) as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError:
        return ""


def _problem(file: Path, result: _Result, sums: Mapping[Path, str] | None) -> str:
    """Why a file is not imported; empty if it is."""
    if isinstance(result, MagicalError):
        return str(result)
    found = result[0].source_sha256 or ""
    if sums is not None and found != sums[file]:
        return f"{file}: expected SHA-256 {sums[file][:12]}..., found {found[:12]}..."
    return ""


def _convert(file: Path, max_bytes: int) -> _Result:
    try:
        trajectory = read_published(file, max_bytes)
        raw = encode(trajectory)
        return ManifestEntry.of(trajectory, raw), raw
    except MagicalError as error:
        return error
