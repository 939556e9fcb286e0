"""A dataset: a folder with one file for each trajectory, and a manifest with their checksums."""

import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np

from magical.demos.store import manifest
from magical.demos.store.codec import MAX_FILE, decode
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.reader import read_all
from magical.demos.store.trajectory import Trajectory
from magical.envs.action_spec import ActionSpaceName
from magical.envs.ids import parse_env_id, split_env_id
from magical.errors import DatasetError
from magical.files import LOCK, locked, open_regular, reading
from magical.messages import printable
from magical.observe import Observation
from magical.tasks import get_task
from magical.tasks.axes import full_variant

MAX_MESSAGE = 1000  # characters of a problem: paths, and what was found


@dataclass(frozen=True, slots=True)
class Problem:
    """A damaged or unlisted file of a dataset, or a damaged line of its manifest."""

    file: str
    what: str

    def __str__(self) -> str:
        named = self.what.startswith(self.file)
        return printable(self.what if named else f"{self.file}: {self.what}", MAX_MESSAGE)


class Dataset(Sequence[Trajectory]):
    """Trajectories of any mix of tasks and variants, read from disk one at a time.

    `dataset[i]`, iteration and `filter` never hold more than one trajectory in memory. Reading a
    damaged file raises a `DatasetError` that names it; the others stay readable.

    Attributes:
        path: the dataset's folder.
        entries: one `ManifestEntry` for each trajectory.
        problems: the problems that `open(..., skip_damaged=True)` found.
    """

    def __init__(
        self, path: Path, entries: Sequence[ManifestEntry], problems: Sequence[Problem] = ()
    ) -> None:
        self.path = path
        self.entries = tuple(entries)
        self.problems = tuple(problems)

    @classmethod
    def open(cls, path: Path | str, *, skip_damaged: bool = False) -> "Dataset":
        """Open the dataset in a folder.

        Args:
            path: the folder.
            skip_damaged: read every file now; leave damaged ones out and list them in `problems`.

        Raises:
            DatasetError: there is no dataset, or, without `skip_damaged`, the manifest is damaged
                or does not list all files.
        """
        folder = Path(path)
        with reading(folder, DatasetError), locked(folder / LOCK, reading=True):
            entries, problems = read_manifest(folder)
        if problems and not skip_damaged:
            more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
            raise DatasetError(
                f"{problems[0]}{more}; to use the rest: Dataset.open(..., skip_damaged=True)"
            )
        dataset = cls(folder, entries)
        if not skip_damaged:
            return dataset
        intact = []
        for entry in entries:
            try:
                dataset.read(entry)
                intact.append(entry)
            except DatasetError as error:
                problems.append(Problem(str(folder / entry.file), str(error)))
        return cls(folder, intact, problems)

    def __len__(self) -> int:
        """The number of trajectories."""
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> Trajectory: ...

    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...

    def __getitem__(self, index: int | slice) -> "Trajectory | Dataset":
        """One trajectory, read and checked now; for a slice, part of the dataset."""
        if isinstance(index, slice):
            return Dataset(self.path, self.entries[index])
        return self.read(self.entries[index])

    def __iter__(self) -> Iterator[Trajectory]:
        """Read the trajectories one after another."""
        return map(self.read, self.entries)

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {len(self)} trajectories)"

    def read(self, entry: ManifestEntry) -> Trajectory:
        """Read and check the trajectory of an entry.

        Raises:
            DatasetError: the file, which the message names, is missing, damaged or not the one in
                the manifest.
        """
        path = self.path / entry.file
        raw = read_file(path, entry.size)
        if hashlib.sha256(raw).hexdigest() != entry.sha256:
            raise DatasetError(
                f"{path}: expected SHA-256 {entry.sha256[:12]}..., found another; the file was "
                "changed after it was written"
            )
        try:
            trajectory = decode(raw)
        except DatasetError as error:
            raise DatasetError(f"{path}: {error}") from error
        if ManifestEntry.of(trajectory, raw, entry.index) != entry:
            raise DatasetError(f"{path}: the manifest describes another one; {manifest.ADVICE}")
        return trajectory

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

        Args:
            task: name of a task.
            variant: name of a variant, such as `TestJitter` or `Jitter`.
            env_id: environment id; a preset in it is ignored.
            demonstrator: the demonstrator's name.
            min_score: lower bound on the appendix's score, or on the published code's if poses are
                unknown (human demonstrations).

        Raises:
            UnknownNameError: there is no such task, variant or environment.
        """
        # A name that is not in the dataset is not an error; a misspelt one is.
        if task and all(task != entry.task for entry in self.entries):
            get_task(task)
        if variant and all(variant != entry.variant for entry in self.entries):
            variant = full_variant(variant)
        wanted = env_id and split_env_id(env_id).without_preset
        if wanted and all(wanted != entry.env_id for entry in self.entries):
            parse_env_id(str(wanted))
        return Dataset(
            self.path,
            [
                entry
                for entry in self.entries
                if task in (None, entry.task)
                and variant in (None, entry.variant)
                and wanted in (None, entry.env_id)
                and demonstrator in (None, entry.demonstrator)
                and (min_score is None or entry.final_score >= min_score)
            ],
        )

    def sample(self, count: int, rng: np.random.Generator) -> "Dataset":
        """`count` trajectories sampled without replacement, in the dataset's order.

        Raises:
            DatasetError: there are fewer trajectories.
        """
        if count > len(self):
            raise DatasetError(f"{self.path}: expected {count} trajectories, found {len(self)}")
        chosen = sorted(rng.choice(len(self), count, replace=False).tolist())
        return Dataset(self.path, [self.entries[i] for i in chosen])

    def action_space(self) -> ActionSpaceName:
        """The kind of actions that all trajectories can have: continuous if any have those.

        Reads trajectories until it finds continuous actions.
        """
        spaces = (trajectory.action_space for trajectory in self)
        return "continuous" if "continuous" in spaces else "discrete"

    def arrays(self, observation: Observation = "LoRes4E") -> dict[str, Any]:
        """All N steps of all trajectories as plain arrays.

        Args:
            observation: see `magical.observe.make_spec`.

        Returns:
            `observations` (N, *shape), or a dict of such arrays: the observation before each
            action; `None` if there are no trajectories.
            `actions` (N,) int64, or (N, 3) float64 if any are continuous: the executed actions.
            `labels`, of the same form: the actions to imitate; they may differ from those executed.
            `is_demonstrated` (N,) bool: false if a policy acted and no expert labelled the state.
            `episodes` (N,) int64: index of the trajectory in the dataset.
            `steps` (N,) int64: index of the step in the trajectory.
            `env_ids`, `scores`, `published_code_scores`, `demonstrators`: one for each trajectory.

        Raises:
            DatasetError: a file is damaged.
            ObservationError: the tasks' state vectors have different lengths.
            TrajectoryError: a recording lacks what the observation needs.
            UnknownNameError: there is no such observation.
        """
        entries = self.entries
        lengths = np.array([entry.length for entry in entries], np.int64)
        starts = np.cumsum(lengths) - lengths
        total = int(lengths.sum())
        return read_all(self, total, observation) | {
            "episodes": np.repeat(np.arange(len(lengths)), lengths),
            "steps": np.arange(total) - np.repeat(starts, lengths),
            "env_ids": np.array([str(entry.env_id) for entry in entries]),
            "scores": np.array([np.nan if e.score is None else e.score for e in entries]),
            "published_code_scores": np.array([e.published_code_score for e in entries]),
            "demonstrators": np.array([entry.demonstrator for entry in entries]),
        }


def read_manifest(folder: Path) -> tuple[list[ManifestEntry], list[Problem]]:
    """The manifest's entries, and its damaged or missing lines; the caller holds the lock.

    Raises:
        DatasetError: there is no manifest, or the trajectories' folder is a symbolic link.
    """
    entries, damaged = manifest.read_entries(folder)
    problems = [Problem(str(folder / manifest.NAME), line) for line in damaged]
    listed = {entry.file for entry in entries}
    problems += [
        Problem(str(path), f"not in the manifest; {manifest.ADVICE}")
        for path in stored_files(folder)
        if f"{manifest.FOLDER}/{path.name}" not in listed
    ]
    return entries, problems


def stored_files(folder: Path) -> list[Path]:
    """The paths of a dataset's trajectory files, listed or not, sorted by name.

    Raises:
        DatasetError: their folder is a symbolic link, which could lead outside the dataset.
    """
    stored = folder / manifest.FOLDER
    if stored.is_symlink():
        raise DatasetError(f"{stored}: expected a folder of the dataset, found a symbolic link")
    return sorted(stored.glob("*.npz"))


def read_file(path: Path, size: int | None = None) -> bytes:
    """A trajectory file's bytes; there must be `size` of them, if given.

    Raises:
        DatasetError: the file, which the message names, is missing, not a regular file, or of
            another size.
    """
    limit = MAX_FILE if size is None else size
    with reading(path, DatasetError), open_regular(path) as file:
        found = os.fstat(file.fileno()).st_size
        if found > limit or size not in (None, found):
            raise DatasetError(
                f"{path}: expected {'at most ' if size is None else ''}{limit} bytes, "
                f"found {found}; the file was changed or cut off after it was written"
            )
        return file.read(found)
