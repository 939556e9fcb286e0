"""A dataset: a folder with one `.npz` file for each trajectory.

A file holds `header` (JSON as uint8), `actions` (T,) uint8, or (T, 3) float64 if continuous, and
`bodies` (T + 1, 5 + blocks, 6) float64 or `frames_allo` and `frames_ego` (T + 1, 96, 96, 3) uint8,
or all of them; and `expert_actions`, `policy_actions` and `actors` if the trajectory has them. In
version 1 there are `poses` (T + 1, 5 + blocks, 3) instead of `bodies`.

Files may come from anybody: what they declare is compared with limits before memory is taken, and
no pickle is loaded.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from threading import Lock
from typing import Annotated, Any, overload
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np
from msgspec import Meta
from numpy.lib import format as npy
from numpy.typing import NDArray

from magical.demos.trajectory import ACTION_COLUMNS, VIEWS, Trajectory, without_velocities
from magical.envs.action_spec import ActionSpaceName, spec_of
from magical.envs.ids import EnvId, parse_env_id, split_env_id
from magical.errors import DatasetError, MagicalError, TrajectoryError
from magical.files import MAX_BYTES, convert, parse_json, write_atomically
from magical.grouping import group_by
from magical.messages import printable, quoted
from magical.scene import Dynamics, Scene
from magical.tasks import get_task
from magical.tasks.axes import full_variant

SUFFIX = ".npz"
MAX_FILE = 64 << 20  # bytes on disk; the largest human recording has 0.6 MB
MAX_UNPACKED = 512 << 20  # bytes of all arrays together
MAX_MEMBERS = 16
_HEADERS = Lock()  # they are read by CPython's `ast`, which in 3.11 may fail in several threads
MAX_ACTIONS = 1 << 21  # bytes; a discrete action has one
FORMATS = ("magical-trajectory", 1), ("magical-trajectory", 2)
_FIELDS = ("seed", "score", "published_code_score", "demonstrator", "metadata")  # of the header

Score = Annotated[float, Meta(ge=0.0, le=1.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """What a dataset knows of a trajectory without reading its arrays."""

    file: str  # relative to the dataset's folder
    env_id: EnvId  # of a task that need not be installed here
    length: int  # control steps
    action_space: ActionSpaceName
    seed: Annotated[int, Meta(ge=0)] | None
    score: Score | None
    published_code_score: Score
    demonstrator: str
    metadata: dict[str, Any] = field(hash=False)
    scene: dict[str, Any] = field(hash=False, repr=False)
    dynamics: dict[str, Any] = field(hash=False, repr=False)
    has_poses: bool
    has_labels: bool  # actions to imitate in addition to the executed ones
    size: int  # bytes on disk
    fingerprint: str  # equal for equal actions and bodies or frames; no defence against forgery

    @property
    def name(self) -> str:
        """The name of the published file that it was imported from, if any, or the file's."""
        source = self.metadata.get("source")
        return source if isinstance(source, str) else self.file

    @property
    def final_score(self) -> float:
        """The appendix's score, or the published code's if poses are unknown."""
        return self.published_code_score if self.score is None else self.score

    @property
    def task(self) -> str:
        """The task's name."""
        return self.env_id.task

    @property
    def variant(self) -> str:
        """The variant's name."""
        return self.env_id.variant


class Dataset(Sequence[Trajectory]):
    """Trajectories of any mix of tasks and variants, read from disk one at a time.

    `dataset[i]`, iteration and `filter` never hold more than one trajectory in memory. They are in
    the order of the files' names.

    Attributes:
        path: the dataset's folder.
        entries: one `Entry` for each trajectory.
    """

    def __init__(self, path: Path, entries: Sequence[Entry]) -> None:
        self.path = path
        self.entries = tuple(entries)

    @classmethod
    def open(cls, path: Path | str) -> "Dataset":
        """Read the headers of all `.npz` files in a folder and its subfolders.

        Raises `DatasetError` if there is no such folder, or a file is not a trajectory's.
        """
        folder = Path(path)
        if not folder.is_dir():
            raise DatasetError(f"{folder}: expected a dataset, a folder with {SUFFIX} files")
        # An empty file is one that is being written, or whose writer was killed.
        files = (file for file in sorted(folder.rglob(f"*{SUFFIX}")) if file.stat().st_size)
        return cls(folder, [_entry(file, folder) for file in files])

    def __len__(self) -> int:
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> Trajectory: ...

    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...

    def __getitem__(self, index: int | slice) -> "Trajectory | Dataset":
        """One trajectory, read and checked now; for a slice, part of the dataset."""
        if isinstance(index, slice):
            return Dataset(self.path, self.entries[index])
        return _read(self.path / self.entries[index].file)

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {len(self)} trajectories)"

    def filter(
        self,
        *,
        task: str | None = None,
        variant: str | None = None,
        env_id: str | None = None,
        demonstrator: str | None = None,
        min_score: float | None = None,
    ) -> "Dataset":
        """The part of the dataset that meets all given conditions; reads no trajectories.

        `variant` is a name such as `TestJitter` or `Jitter`; `env_id` stands for its task and
        variant; `min_score` bounds the appendix's score, or the published code's where poses are
        unknown. Raises `UnknownNameError` for a misspelt name.
        """
        if env_id is not None:
            task, variant = split_env_id(env_id).task, split_env_id(env_id).variant
        # A name that is not in the dataset is not an error; a misspelt one is.
        if task and all(task != entry.task for entry in self.entries):
            get_task(task)
        if variant and all(variant != entry.variant for entry in self.entries):
            variant = full_variant(variant)
        kept = [
            entry
            for entry in self.entries
            if (task is None or entry.task == task)
            and (variant is None or entry.variant == variant)
            and (demonstrator is None or entry.demonstrator == demonstrator)
            and (min_score is None or entry.final_score >= min_score)
        ]
        return Dataset(self.path, kept)

    def sample(self, count: int, rng: np.random.Generator) -> "Dataset":
        """`count` trajectories sampled without replacement, in the dataset's order."""
        if count > len(self):
            raise DatasetError(f"{self.path}: expected {count} trajectories, found {len(self)}")
        chosen = sorted(rng.choice(len(self), count, replace=False).tolist())
        return Dataset(self.path, [self.entries[i] for i in chosen])

    def duplicates(self) -> list[tuple[str, str]]:
        """Pairs (later, earlier) of files of one environment with the same actions and motions."""
        first: dict[tuple[str, str], Entry] = {}
        pairs = [(e, first.setdefault((e.env_id, e.fingerprint), e)) for e in self.entries]
        return [(later.name, earlier.name) for later, earlier in pairs if later is not earlier]

    def action_space(self) -> ActionSpaceName:
        """The kind of actions that all trajectories can have: continuous if any have those."""
        spaces = {entry.action_space for entry in self.entries}
        return "continuous" if "continuous" in spaces else "discrete"


class DatasetWriter:
    """Appends to a dataset, created if it does not exist; several processes may append at once.

    Files are numbered, and have contents only when they are complete. Raises `DatasetError` if the
    folder contains other files, or cannot be written.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        with self._writing():
            self.path.mkdir(parents=True, exist_ok=True)
            names = sorted(file.name for file in self.path.glob("[!.]*") if file.is_file())
        stems = [name.removesuffix(SUFFIX) for name in names]
        numbers = [int(stem) for stem in stems if stem.isdigit()]
        if names and not numbers:
            raise DatasetError(f"{self.path}: expected a dataset, found {quoted(names)}")
        self._next = max(numbers, default=-1) + 1

    def append(self, trajectory: Trajectory) -> Entry:
        """Store a trajectory; on failure, as on a full disk, the dataset stays as it was."""
        arrays = _to_arrays(trajectory)
        with self._writing():
            while True:
                path = self.path / f"{self._next:06d}{SUFFIX}"
                self._next += 1
                with suppress(FileExistsError):  # another process has taken the number
                    path.touch(exist_ok=False)
                    break
            try:
                with write_atomically(path) as file:
                    np.savez_compressed(file, allow_pickle=False, **arrays)
            except BaseException:
                path.unlink()
                raise
        return _entry(path, self.path)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            where = error.filename or self.path
            raise DatasetError(f"{where}: cannot be written: {error.strerror or error}") from error


def _entry(path: Path, folder: Path) -> Entry:
    with _opened(path, folder) as (_, entry, _):
        return entry


def _read(path: Path) -> Trajectory:
    """Read a trajectory's file; raises `DatasetError` if it is damaged, too large, or another."""
    with _opened(path, path.parent) as (archive, entry, actions):
        names = {info.filename.removesuffix(".npy") for info in archive.infolist()}
        arrays = {name: _load(archive, name) for name in names - {"header", "actions"}}
        frames = {view: arrays[f"frames_{view}"] for view in VIEWS if f"frames_{view}" in arrays}
        bodies = arrays.get("bodies")
        if bodies is None and "poses" in arrays:
            bodies = without_velocities(arrays["poses"])
        return Trajectory(
            env_id=parse_env_id(str(entry.env_id)),
            **{name: getattr(entry, name) for name in _FIELDS},
            scene=Scene.from_dict(entry.scene),
            dynamics=Dynamics.from_dict(entry.dynamics),
            actions=actions,
            **{name: arrays.get(name) for name in (*ACTION_COLUMNS[1:], "actors")},  # type: ignore[arg-type]
            bodies=bodies,
            frames=frames or None,
        )


@contextmanager
def _opened(path: Path, folder: Path) -> Iterator[tuple[ZipFile, Entry, NDArray[Any]]]:
    """Open a file; any error in the block becomes a `DatasetError` that names it."""
    try:
        if (size := path.stat().st_size) > MAX_FILE:
            raise DatasetError(f"expected at most {MAX_FILE} bytes, found more")
        with ZipFile(path) as archive:
            infos = archive.infolist()
            if len(infos) > MAX_MEMBERS or sum(info.file_size for info in infos) > MAX_UNPACKED:
                raise DatasetError(f"expected {MAX_MEMBERS} arrays, {MAX_UNPACKED} bytes at most")
            if any(info.compress_type not in (ZIP_STORED, ZIP_DEFLATED) for info in infos):
                raise DatasetError("expected deflated data: another compression needs gigabytes")
            actions = _load(archive, "actions", MAX_ACTIONS)
            text = _load(archive, "header", MAX_BYTES).tobytes()
            header = parse_json(text, dict[str, Any], "header", DatasetError)
            kind = header.pop("format", None), header.pop("version", None)
            if kind not in FORMATS or not re.fullmatch(r"[\w/-]{1,200}", header["env_id"]):
                raise DatasetError(f"expected a trajectory, found {quoted(kind)}")
            parts = {info.filename: info.CRC for info in infos if info.filename != "header.npy"}
            digest = hashlib.sha256(repr(sorted(parts.items())).encode()).hexdigest()
            header |= {
                "file": path.relative_to(folder).as_posix(),
                "env_id": split_env_id(header["env_id"]),
                "length": len(actions),
                "action_space": spec_of(actions).name,
                "has_poses": "bodies.npy" in parts or "poses.npy" in parts,
                "has_labels": "expert_actions.npy" in parts,
                "size": size,
                "fingerprint": digest[:16],
            }
            yield archive, convert(header, Entry, "header", DatasetError), actions
    except MagicalError as error:
        raise DatasetError(f"{path}: {printable(str(error), 1000)}") from error
    except Exception as error:  # zipfile, zlib, NumPy and the constructors raise many kinds
        what = printable(f"{type(error).__name__}: {error}")
        raise DatasetError(f"{path}: expected a trajectory, found another file: {what}") from error


def _load(archive: ZipFile, name: str, most: int = MAX_UNPACKED) -> NDArray[Any]:
    """An array of at most `most` bytes, whatever its header declares: NumPy would believe it."""
    with archive.open(f"{name}.npy") as file:
        with _HEADERS:
            npy.read_magic(file)
            shape, by_columns, dtype = npy.read_array_header_1_0(file)
        data = file.read(most)  # of objects, NumPy makes no array
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")


def _to_arrays(trajectory: Trajectory) -> dict[str, NDArray[Any]]:
    scene, dynamics = trajectory.scene.to_dict(), trajectory.dynamics.to_dict()
    header = {"format": FORMATS[-1][0], "version": FORMATS[-1][1], "env_id": trajectory.env_id}
    header |= {name: getattr(trajectory, name) for name in _FIELDS}
    header |= {"scene": scene, "dynamics": dynamics}
    text = json.dumps(header).encode()
    if len(text) > MAX_BYTES:
        raise TrajectoryError(f"metadata: expected at most {MAX_BYTES} bytes, found {len(text)}")
    arrays: dict[str, NDArray[Any]] = {"header": np.frombuffer(text, np.uint8)}
    for name in (*ACTION_COLUMNS, "actors", "bodies"):
        if (array := getattr(trajectory, name)) is not None:
            arrays[name] = array if array.dtype.kind == "f" else array.astype(np.uint8)
    for view, frames in (trajectory.frames or {}).items():
        arrays[f"frames_{view}"] = frames
    return arrays


def summarise(entries: Iterable[Entry]) -> list[dict[str, Any]]:
    """Counts and means of the trajectories of each environment, as plain data, sorted by id."""
    return [
        {
            "env_id": str(env_id),
            "count": len(group),
            "with_poses": sum(entry.has_poses for entry in group),
            "with_labels": sum(entry.has_labels for entry in group),
            "lengths": [f(entry.length for entry in group) for f in (min, max)],
            "score": _mean([entry.score for entry in group if entry.score is not None]),
            "published_code_score": _mean([entry.published_code_score for entry in group]),
            "bytes": sum(entry.size for entry in group),
            "action_spaces": sorted({entry.action_space for entry in group}),
            "demonstrators": sorted({entry.demonstrator for entry in group}),
        }
        for env_id, group in sorted(group_by(entries, attrgetter("env_id")).items())
    ]


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
