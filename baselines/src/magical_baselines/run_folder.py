"""Run folders being written: created, locked, checked before a run is resumed; their metrics.

`magical.runs` describes and reads the files.
"""

import errno
import json
import math
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from magical.errors import MagicalError, RunFolderError
from magical.files import LOCK, write_atomically, write_json
from magical.messages import printable, quoted
from magical.runs import (
    CHECKPOINT,
    CONFIG,
    CURVES,
    METRICS,
    RECORD,
    TENSORBOARD,
    is_run,
    read_json,
    read_metrics,
    versions,
)

# Settings that may change when a run is resumed. The dataset may have been moved: its contents are
# compared instead. The others do not change the result.
CHANGEABLE = ("demos", "workers", "log_every", "checkpoint_every")


@contextmanager
def opened_folder(path: Path, config: Mapping[str, Any], resume: bool) -> Iterator[None]:
    """Hold the lock of a run folder for training; a new folder is created.

    A new run that fails before it has logged or saved anything, for instance for lack of
    demonstrations, is removed again, so that the corrected command finds the folder as it was.

    Args:
        path: a new or an empty folder; with `resume`, one that holds the run.
        config: the configuration as plain data.
        resume: whether to continue an existing run.

    Raises:
        RunFolderError: another process trains this run; the folder holds another configuration, or
            the same one and `resume` is false; it holds other files; there is nothing to resume;
            the disk is full.
    """
    new, existed = not is_run(path), path.exists()
    if resume and new:
        raise RunFolderError(f"{path}: expected a run to resume, found none")
    if new and existed and not (path.is_dir() and {f.name for f in path.iterdir()} <= {LOCK}):
        found = "other things in it" if path.is_dir() else "a file"
        raise RunFolderError(f"{path}: expected a new or an empty folder, found {found}")
    with owned(path, RunFolderError, "trains this run"):
        if not new:
            for name in (CONFIG, RECORD, METRICS, CHECKPOINT, CURVES):
                for partial in path.glob(f".{name}.*.part"):  # of a process that was killed
                    partial.unlink()
            _check_existing(path, config, resume)
            yield
            return
        write_json(path / CONFIG, config)
        write_json(path / RECORD, {"versions": versions(), "began": f"{datetime.now(UTC):%FT%TZ}"})
        try:
            yield
        except Exception:
            metrics = path / METRICS
            logged = metrics.is_file() and metrics.stat().st_size > 0
            if not logged and not (path / CHECKPOINT).exists():
                shutil.rmtree(path / TENSORBOARD, ignore_errors=True)
                with suppress(OSError):  # Windows keeps the lock file, which is open
                    for name in (CONFIG, RECORD, METRICS, CURVES, LOCK):
                        (path / name).unlink(missing_ok=True)
                    if not existed:
                        path.rmdir()
            raise


def _check_existing(path: Path, config: Mapping[str, Any], resume: bool) -> None:
    if different := differences(config, read_json(path / CONFIG)):
        raise RunFolderError(
            f"{path} holds a run with another configuration: {different}; choose another "
            "folder, or the same configuration to resume it"
        )
    if not resume:
        raise RunFolderError(
            f"{path} holds this run already; add --resume (resume=True) to continue it, or "
            "choose another folder"
        )


def differences(wanted: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """The settings that differ, and how, other than those in `CHANGEABLE`."""
    names = [name for name in {**wanted, **found} if name not in CHANGEABLE]
    return ", ".join(
        f"{printable(name)} {quoted(found.get(name))} there, {quoted(wanted.get(name))} asked for"
        for name in names
        if wanted.get(name) != found.get(name)
    )


@contextmanager
def owned(folder: Path, error: type[MagicalError], use: str) -> Iterator[None]:
    """Hold the lock of a folder, which is created; it ends with the process, however that ends.

    Raises `error` if the lock is held elsewhere, by a process that does `use`, or the disk is full.
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


class MetricsWriter:
    """Appends metrics to a run folder, one line of JSON per call."""

    def __init__(self, folder: Path, step: int) -> None:
        """`step` is the checkpoint's: later metrics are dropped, as their steps are redone."""
        path = folder / METRICS
        if path.exists():
            kept = [row for row in read_metrics(folder) if row["step"] <= step]
            with write_atomically(path) as file:
                file.write("".join(json.dumps(row) + "\n" for row in kept).encode())
        self._file = path.open("a", encoding="utf-8")

    def write(self, step: int, metrics: Mapping[str, float | str]) -> None:
        """Append a line; numbers are rounded to 6 decimals, and non-finite ones become null."""
        row = {"step": step, **{name: _plain(value) for name, value in metrics.items()}}
        self._file.write(json.dumps(row) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _plain(value: float | str) -> float | int | str | None:
    if isinstance(value, int | str):
        return value
    return round(float(value), 6) if math.isfinite(value) else None
