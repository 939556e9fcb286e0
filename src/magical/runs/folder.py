"""The files of a run folder: their names, creating the folder, checking it before resuming.

- `config.json`: the configuration
- `run.json`: versions, demonstrations with SHA-256 sums, device and precision
- `metrics.jsonl`: one JSON object per line
- `checkpoint.safetensors`: the newest checkpoint
- `learning-curves.png`: the metrics as a picture
- `tensorboard/`: the metrics again, on request
- `.lock`: locked while the run is trained; holds the process id
"""

import json
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from magical import __version__, untrusted
from magical.errors import RunFolderError
from magical.files import LOCK, OwnedFolder, write_atomically
from magical.messages import printable, quoted
from magical.plugins import distributions

CONFIG = "config.json"
RECORD = "run.json"
METRICS = "metrics.jsonl"
CHECKPOINT = "checkpoint.safetensors"
CURVES = "learning-curves.png"
TENSORBOARD = "tensorboard"
WRITTEN = (CONFIG, RECORD, METRICS, CHECKPOINT, CURVES)  # by the holder of the lock

# Settings that may change when a run is resumed. The dataset may have been moved: its contents are
# compared instead. The others do not change the result.
CHANGEABLE = ("demos", "workers", "log_every", "checkpoint_every")
VERSIONED = ("torch", "numpy", "pymunk", "numba", "safetensors")  # what results may depend on


def is_run(path: Path | str) -> bool:
    """Whether a path is a run folder."""
    try:
        return (Path(path) / CONFIG).is_file()
    except OSError:  # such as a name that is too long
        return False


@contextmanager
def opened_folder(path: Path, config: Mapping[str, Any], resume: bool) -> Iterator[None]:
    """Hold the lock of a run folder for training; a new folder is created.

    Reading a run needs no lock. A new run that fails before it has logged or saved anything, for
    instance for lack of demonstrations, is removed again, so that the corrected command finds the
    folder as it was.

    Args:
        path: a new or an empty folder; with `resume`, one that holds the run.
        config: the configuration as plain data.
        resume: whether to continue an existing run.

    Raises:
        RunFolderError: another process or thread trains this run; the folder holds another
            configuration, or the same one and `resume` is false; it holds other files; there is
            nothing to resume; the disk is full.
    """
    if resume and not is_run(path):
        raise RunFolderError(f"{path}: expected a run to resume, found none")
    existed = path.exists()
    then = "run the same command again, with --resume if the run has begun"
    with OwnedFolder(path, WRITTEN, RunFolderError, "trains this run", then).locked():
        if is_run(path):
            _check_existing(path, config, resume)
            yield
            return
        try:
            write_json(path / CONFIG, config)
            write_json(
                path / RECORD, {"versions": versions(), "began": f"{datetime.now(UTC):%FT%TZ}"}
            )
            yield
        except Exception:
            _remove_unless_begun(path, keep_folder=existed)
            raise


def _remove_unless_begun(path: Path, keep_folder: bool) -> None:
    """Remove the files of a run without metrics or checkpoints, unless there are other files."""
    names = {file.name for file in path.iterdir()}
    has_metrics = METRICS in names and (path / METRICS).stat().st_size > 0
    if has_metrics or CHECKPOINT in names or names - {*WRITTEN, TENSORBOARD, LOCK}:
        return
    shutil.rmtree(path / TENSORBOARD, ignore_errors=True)
    with suppress(OSError):  # Windows keeps the lock file, which is open
        for name in (*WRITTEN, LOCK):
            (path / name).unlink(missing_ok=True)
        if not keep_folder:
            path.rmdir()


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


def versions() -> dict[str, str]:
    """Versions of what results may depend on: Python, this package, libraries, plug-ins."""
    found = {"magical": __version__, "python": platform.python_version()}
    for name in VERSIONED:
        with suppress(metadata.PackageNotFoundError):  # an extra that is not installed
            found[name] = metadata.version(name)
    return {**found, **distributions()}


def read_json(path: Path | str) -> dict[str, Any]:
    """Read a JSON object of a run; raises `RunFolderError` if it is missing or damaged."""
    return untrusted.read_json(Path(path), dict[str, Any], RunFolderError)


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON object, indented, atomically."""
    with write_atomically(path) as file:
        file.write((json.dumps(data, indent=2) + "\n").encode())
