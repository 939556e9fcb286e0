"""The files of a run folder: their names, creating the folder, checking it before resuming.

- `config.json`: the configuration
- `run.json`: versions, demonstrations with SHA-256 sums, device and precision
- `metrics.jsonl`: one JSON object per line
- `checkpoint.safetensors`: the newest checkpoint
- `learning-curves.png`: the metrics as a picture
- `tensorboard/`: the metrics again, on request
- `.lock`: locked while the run is trained
"""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from magical import untrusted
from magical.errors import RunFolderError
from magical.files import LOCK, owned, remove_partial_files
from magical.files import write_json as write_json
from magical.messages import printable, quoted
from magical.runs.machine import versions as versions

CONFIG = "config.json"
RECORD = "run.json"
METRICS = "metrics.jsonl"
CHECKPOINT = "checkpoint.safetensors"
CURVES = "learning-curves.png"
TENSORBOARD = "tensorboard"

# Settings that may change when a run is resumed. The dataset may have been moved: its contents are
# compared instead. The others do not change the result.
CHANGEABLE = ("demos", "workers", "log_every", "checkpoint_every")


def is_run(path: Path | str) -> bool:
    """Whether a path is a run folder."""
    try:
        return (Path(path) / CONFIG).is_file()
    except (OSError, ValueError):  # such as a name that is too long, or has a null character
        return False


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
            the same one and `resume` is false; it holds other files; there is nothing to resume.
    """
    new, existed = not is_run(path), path.exists()
    if resume and new:
        raise RunFolderError(f"{path}: expected a run to resume, found none")
    if new and path.exists() and not (path.is_dir() and {f.name for f in path.iterdir()} <= {LOCK}):
        found = "other things in it" if path.is_dir() else "a file"
        raise RunFolderError(f"{path}: expected a new or an empty folder, found {found}")
    with owned(path, RunFolderError, "trains this run"):
        if not new:
            remove_partial_files(path, CONFIG, RECORD, METRICS, CHECKPOINT, CURVES)
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
    different = differences(config, read_json(path / CONFIG))
    if different:
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


def read_json(path: Path | str) -> dict[str, Any]:
    """Read a JSON object of a run; raises `RunFolderError` if it is missing or damaged."""
    return untrusted.read_json(Path(path), dict[str, Any], RunFolderError)
