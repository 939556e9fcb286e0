"""The human demonstrations published with the benchmark: downloading, reading, importing.

They are gzipped pickles of 384 x 384 frames (milbench, 2020). Files with published names must have
the published SHA-256 sums. Nothing that a pickle names is imported or called: the five names in the
published files stand for constructors of plain data here, and any other is refused.
"""

import gzip
import io
import math
import pickle
import pickletools
import re
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.dataset import Dataset, DatasetWriter
from magical.demos.trajectory import Trajectory
from magical.envs.action_spec import DISCRETE
from magical.envs.ids import parse_env_id
from magical.errors import DatasetError, MagicalError
from magical.extras import require
from magical.files import sha256_sum
from magical.messages import printable, quoted
from magical.processes import map_in_processes
from magical.scene import View
from magical.scene.constants import FRAME_SIZE, RAW_FRAME_SIZE

# The repository at the commit whose sums are in data/human-demos.sha256.
COMMIT = "42eb21c4bd6c0e2262ccc2fc00ef2a36b10b6a5a"
BASE_URL = f"https://raw.githubusercontent.com/qxcv/magical-data/{COMMIT}"
SUFFIX = ".pkl.gz"
MAX_UNPACKED = 512 << 20  # bytes of its pickle; the largest has 213 MB
MAX_OPCODES = 200_000  # of a pickle, and so objects; the published ones have at most 17,500
BINNING = RAW_FRAME_SIZE // FRAME_SIZE  # pixels averaged along each axis
_SHAPE = (RAW_FRAME_SIZE, RAW_FRAME_SIZE, 3)
FullFrames = Mapping[View, Sequence[NDArray[np.uint8]]]  # T + 1 frames (384, 384, 3) of each view


@dataclass(slots=True)
class ImportReport:
    """Names of the files, grouped by the outcome of their import."""

    imported: list[str] = field(default_factory=list)
    already: list[str] = field(default_factory=list)  # already in the dataset
    duplicates: list[tuple[str, str]] = field(default_factory=list)  # (file, earlier equal file)
    failed: list[tuple[str, str]] = field(default_factory=list)  # (file, reason)


def download(
    sums: Mapping[str, str], folder: Path, base_url: str, progress: Callable[[int], None]
) -> tuple[list[Path], list[str]]:
    """Fetch the files that are not yet in a folder (extra `human`).

    `sums` has the files' SHA-256 sums, by path relative to `base_url` and `folder`. Returns the
    files that are there now, and what is wrong with the others. Raises `DatasetError` if none of
    the first three can be fetched.
    """
    require("human")
    import pooch

    pooch.get_logger().setLevel("WARNING")
    registry = {name: f"sha256:{digest}" for name, digest in sums.items()}
    url = f"{base_url.rstrip('/')}/"
    source = pooch.create(folder, url, registry=registry, retry_if_failed=2)
    found, errors = list[Path](), list[str]()
    for name in sums:
        try:
            found.append(Path(source.fetch(name)))
        except (OSError, ValueError) as error:
            errors.append(f"{url}{name}: {printable(str(error))}; run again for what is missing")
            if not found and len(errors) in (3, len(sums)):
                raise DatasetError(errors[-1]) from error
        progress(1)
    return found, errors


def find_published(source: Path) -> list[Path]:
    """The published files in a folder and its subfolders, or `source` itself if it is a file."""
    found = sorted(source.rglob(f"*{SUFFIX}")) if source.is_dir() else [source]
    if not found or not found[0].is_file():
        raise DatasetError(f"{source}: expected files *{SUFFIX}, found none")
    return found


def import_published(
    files: Sequence[Path],
    out: Path | str,
    *,
    workers: int = 1,
    skip_duplicates: bool = False,
    progress: Callable[[int], None] = lambda _: None,
) -> ImportReport:
    """Append published files to a dataset, in order, unless they are there already.

    A bad file does not stop the others. Each of the `workers` takes half a gigabyte. With
    `skip_duplicates`, files with the same actions and frames as an earlier one are left out.
    """
    writer, entries = DatasetWriter(out), Dataset.open(out).entries
    known = {(entry.name, entry.metadata.get("source_sha256")) for entry in entries}
    wanted = [file for file in files if (file.name, sha256_sum(file)) not in known]
    report = ImportReport(already=[file.name for file in files if file not in wanted])
    first = {entry.fingerprint: Path(entry.name) for entry in entries}
    progress(len(report.already))
    with closing(map_in_processes(_outcome, wanted, min(workers, len(wanted)))) as outcomes:
        for file, outcome in zip(wanted, outcomes, strict=True):
            progress(1)
            if not isinstance(outcome, Trajectory):
                report.failed.append((str(file), outcome or ""))
                continue
            entry = writer.append(outcome)
            if (earlier := first.setdefault(entry.fingerprint, file)) is not file:
                name = str(file) if earlier.name == file.name else file.name
                report.duplicates.append((name, earlier.name))
                if skip_duplicates:
                    (writer.path / entry.file).unlink()
                    continue
            report.imported.append(file.name)
    return report


def _outcome(file: Path) -> Trajectory | str:
    """One file's trajectory, or what is wrong with it."""
    try:
        return read_demonstration(file)[0]
    except MagicalError as error:
        return str(error)


def read_demonstration(path: Path) -> tuple[Trajectory, FullFrames]:
    """Read one published file: its trajectory, of frames averaged 4 x 4, and its own frames.

    Raises `DatasetError` if the file cannot be read, has not the published sum, is damaged, too
    large, or contains anything other than a demonstration as plain data.
    """
    try:
        digest = sha256_sum(path)
        expected = {Path(name).name: known for name, known in published_sums().items()}
        if expected.get(path.name, digest) != digest:
            raise DatasetError(f"expected SHA-256 {expected[path.name]}, found {digest}")
        with gzip.open(path) as file:
            data = file.read(MAX_UNPACKED + 1)
        if len(data) > MAX_UNPACKED:
            raise DatasetError(f"unpacks to more than {MAX_UNPACKED} bytes")
        return _demonstration(_load(data), {"source": path.name, "source_sha256": digest})
    except MagicalError as error:
        raise DatasetError(f"{path}: {error}") from error
    except Exception as error:  # gzip, pickle and NumPy raise many kinds
        what = printable(f"{type(error).__name__}: {error}")
        raise DatasetError(f"{path}: expected a demonstration, found {what}") from error


def average(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A frame (384, 384, 3) averaged 4 x 4 to (96, 96, 3), with halves rounded to even."""
    rows = frame.reshape(FRAME_SIZE, BINNING, -1).sum(axis=1, dtype=np.uint16)
    total = rows.reshape(FRAME_SIZE, FRAME_SIZE, BINNING, 3).sum(axis=2)
    return np.asarray(np.rint(total / BINNING**2).astype(np.uint8))


@cache
def published_sums() -> Mapping[str, str]:
    """SHA-256 sums of the 203 published files, by path in the repository qxcv/magical-data."""
    text = (files("magical.demos") / "data" / "human-demos.sha256").read_text()
    lines = (line.split(maxsplit=1) for line in text.splitlines())
    return {path: digest for digest, path in lines}


_NAMES: Mapping[tuple[str, str], Any] = {
    ("numpy", "dtype"): lambda code, *_: np.dtype({"u1": "u1", "i8": "<i8"}.get(code, "<f8")),
    ("numpy", "ndarray"): None,  # the first argument of the next one, which does not use it
    ("numpy.core.multiarray", "_reconstruct"): lambda *_: np.ndarray(0, np.uint8),
    ("collections", "OrderedDict"): dict,
    ("milbench.baselines.saved_trajectories", "MILBenchTrajectory"): namedtuple(
        "MILBenchTrajectory", ("acts", "obs", "rews", "infos")
    ),
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _NAMES:
            return _NAMES[module, name]
        found = printable(f"{module}.{name}")
        raise DatasetError(f"expected plain data, found the name {found}; nothing was executed")


def _load(data: bytes) -> Any:
    for count, (opcode, argument, _) in enumerate(pickletools.genops(data)):
        index = argument if isinstance(argument, int) and "PUT" in opcode.name else 0
        if max(count, index) > MAX_OPCODES:
            raise DatasetError(f"expected at most {MAX_OPCODES} objects, found more")
    return _Unpickler(io.BytesIO(data)).load()


def _demonstration(data: Any, source: Mapping[str, str]) -> tuple[Trajectory, FullFrames]:
    record, env_name, score = data["trajectory"], data["env_name"], data["score"]
    if not re.fullmatch(r"\w+-Demo-v0", env_name):  # no module's name, which would be imported
        raise DatasetError(f"expected a Demo environment, found {quoted(env_name)}")
    if not isinstance(score, int | float) or not 0.0 <= score <= 1.0:
        raise DatasetError(f"score: expected a number from 0 to 1, found {quoted(score)}")
    if len(record.obs) * math.prod(_SHAPE) > MAX_UNPACKED:  # frames may be shared
        raise DatasetError(f"obs: expected fewer, found {len(record.obs)}")
    actions = DISCRETE.checked_batch(record.acts, len(record.obs) - 1, "acts")
    frames = {view: [observed[view] for observed in record.obs] for view in View}
    for frame in (frame for of_view in frames.values() for frame in of_view):
        if not isinstance(frame, np.ndarray) or frame.shape != _SHAPE or frame.dtype != np.uint8:
            raise DatasetError(f"obs: expected uint8 frames {_SHAPE}, found {quoted(frame)}")
    env_id = parse_env_id(env_name)
    trajectory = Trajectory(
        env_id=env_id,
        scene=env_id.task_spec.demo,  # every episode of a Demo environment has this scene
        actions=actions,
        frames={view: np.stack([*map(average, of_view)]) for view, of_view in frames.items()},
        published_code_score=float(score),
        demonstrator="human",
        metadata=source,
    )
    return trajectory, frames
