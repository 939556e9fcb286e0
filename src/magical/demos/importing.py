"""Importing the published human demonstrations into a dataset."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from magical.demos.codec import encode
from magical.demos.dataset import Dataset
from magical.demos.manifest import Entry
from magical.demos.processes import in_processes, usable_cores
from magical.demos.published import MAX_UNPACKED, read_published
from magical.demos.writer import DatasetWriter
from magical.errors import DatasetError, MagicalError

SUFFIX = ".pkl.gz"
Progress = Callable[[int], None]  # is told how many files have just been dealt with
_Result = tuple[Entry, bytes] | MagicalError


@dataclass(frozen=True, slots=True)
class ImportReport:
    """What became of the files, by their names."""

    imported: tuple[str, ...]
    already: tuple[str, ...]  # were in the dataset before
    duplicates: tuple[tuple[str, str], ...]  # (file, earlier file with the same bytes)
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

    Files of the same name and bytes that are in the dataset already are left alone. Files with the
    same bytes as another are imported, unless `skip_duplicates`, and reported either way.

    Raises:
        DatasetError: the dataset cannot be written; what was imported before stays.
    """
    writer = DatasetWriter(out)
    known = {(e.source, e.source_sha256) for e in Dataset.open(out).entries}
    first_of: dict[str, str] = {digest: name for name, digest in known if name and digest}
    already, duplicates, failed, wanted = [], [], [], []
    for file in files:
        digest = _sum(file)
        if (file.name, digest) in known:
            already.append(file.name)
            continue
        if digest in first_of:
            duplicates.append((file.name, first_of[digest]))
        if digest not in first_of or not skip_duplicates:
            wanted.append(file)
        first_of.setdefault(digest, file.name)
    tell = progress or (lambda _: None)
    tell(len(files) - len(wanted))
    imported = []
    workers = min(workers or usable_cores(), len(wanted))
    results = in_processes(partial(_convert, max_bytes=max_bytes), wanted, workers)
    for file, result in zip(wanted, results, strict=True):
        if isinstance(result, MagicalError):
            failed.append((str(file), str(result)))
        else:
            writer.append_encoded(*result)
            imported.append(file.name)
        tell(1)
    return ImportReport(tuple(imported), tuple(already), tuple(duplicates), tuple(failed))


def _sum(file: Path) -> str:
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError:
        return f"unreadable {file}"  # reading it will say why


def _convert(file: Path, max_bytes: int) -> _Result:
    try:
        trajectory = read_published(file, max_bytes)
        raw = encode(trajectory)
        return Entry.of(trajectory, raw), raw
    except MagicalError as error:
        return error
