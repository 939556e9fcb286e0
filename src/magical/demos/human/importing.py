"""Importing the published human demonstrations into a dataset."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

from magical.demos.human.published import MAX_PATH, file_sum, naming_errors, read_demonstration
from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import ManifestEntry, encoded
from magical.demos.store.trajectory import RECOVERY
from magical.demos.store.writer import DatasetWriter
from magical.errors import DatasetError, MagicalError, WorkerError
from magical.messages import printable
from magical.processes import checked_workers, map_in_processes

SUFFIX = ".pkl.gz"
# What imported trajectories contain; always frames if the poses cannot be recovered.
Contents = Literal["poses", "both", "frames"]


@dataclass(slots=True)
class ImportReport:
    """Names of the files, grouped by the outcome of their import."""

    imported: list[str] = field(default_factory=list)
    already: list[str] = field(default_factory=list)  # already in the dataset
    # (file, earlier file with the same actions and poses or frames)
    duplicates: list[tuple[str, str]] = field(default_factory=list)
    failed: list[tuple[str, str]] = field(default_factory=list)  # (file, reason)
    # (imported file, why it keeps its frames)
    without_poses: list[tuple[str, str]] = field(default_factory=list)


def find_published(source: Path) -> list[Path]:
    """The published files in a folder and its subfolders, or `source` itself if it is a file.

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
    keep: Contents = "poses",
    workers: int | None = None,
    skip_duplicates: bool = False,
    progress: Callable[[int], None] = lambda _: None,
) -> ImportReport:
    """Append published files to a dataset, in order; a bad file does not stop the others.

    Files that are already in the dataset are skipped.

    Args:
        files: the published files.
        out: the dataset's folder, created if it does not exist.
        keep: what to keep of each demonstration.
        workers: number of processes (default: one per core).
        skip_duplicates: skip files with the same actions and poses or frames as an earlier one.
        progress: called with the number of files finished since the last call.

    Raises:
        DatasetError: the dataset cannot be written; what was already imported stays.
    """
    writer, entries = DatasetWriter(out), Dataset.open(out).entries
    known = {(entry.source, entry.source_sha256) for entry in entries}
    wanted = [file for file in files if (file.name, file_sum(file, follow_links=True)) not in known]
    report = ImportReport(already=[file.name for file in files if file not in set(wanted)])
    first = {entry.fingerprint: entry.source or entry.file for entry in entries}
    progress(len(report.already))
    workers = min(checked_workers(workers), len(wanted))
    convert = partial(_outcome, keep=keep)
    with closing(map_in_processes(convert, wanted, workers)) as results:
        for file, result in zip(wanted, results, strict=True):
            progress(1)
            if isinstance(result, Exception):
                report.failed.append((str(file), _reason(file, result)))
                continue
            entry, raw, problem = result
            if _is_copy(entry, file, first, report.duplicates) and skip_duplicates:
                continue
            writer.append_encoded(entry, raw)
            report.imported.append(file.name)
            if problem:
                report.without_poses.append((file.name, problem))
    return report


def _is_copy(
    entry: ManifestEntry, file: Path, first: dict[str, str], copies: list[tuple[str, str]]
) -> bool:
    """Whether an earlier file, perhaps of the same name, is equal; notes it in `copies`."""
    if earlier := first.get(entry.fingerprint):
        copies.append((str(file) if earlier == file.name else file.name, earlier))
        return True
    first[entry.fingerprint] = file.name
    return False


def _outcome(file: Path, keep: Contents) -> tuple[ManifestEntry, bytes, str | None] | Exception:
    try:
        return _convert(file, keep)
    except Exception as error:
        return error


def _convert(file: Path, keep: Contents) -> tuple[ManifestEntry, bytes, str | None]:
    """One file as an encoded trajectory, and the reason if its poses could not be recovered."""
    demonstration = read_demonstration(file)
    with naming_errors(file):
        if keep == "frames":
            trajectory = demonstration.trajectory()
        else:
            # This imports numba, which only the recovery needs.
            from magical.demos.human.recovery.recovery import recovered_trajectory

            trajectory = recovered_trajectory(demonstration, keep_frames=keep == "both")
    return *encoded(trajectory), trajectory.metadata.get(RECOVERY, {}).get("problem")


def _reason(file: Path, error: Exception) -> str:
    """Why a file failed, with its name; text that may come from the file is cut and escaped."""
    name = printable(str(file), MAX_PATH)
    known = isinstance(error, MagicalError) and not isinstance(error, WorkerError)
    reason = str(error) if known else printable(f"{type(error).__name__}: {error}")
    return reason if name in reason else f"{name}: {reason}"
