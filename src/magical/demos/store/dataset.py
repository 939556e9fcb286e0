"""A dataset: a folder with one file a trajectory, and a manifest with their SHA-256 sums."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np

from magical.demos.store import manifest
from magical.demos.store.codec import decode
from magical.demos.store.lock import locked
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.trajectory import Trajectory
from magical.envs.ids import parse_env_id
from magical.errors import DatasetError, UnknownNameError
from magical.tasks import VARIANTS, get_task


@dataclass(frozen=True, slots=True)
class Problem:
    """Something wrong with a dataset: the file, and what is wrong with it."""

    file: str
    what: str

    def __str__(self) -> str:
        return self.what if self.what.startswith(self.file) else f"{self.file}: {self.what}"


class Dataset(Sequence[Trajectory]):
    """Trajectories of any mix of tasks and variants, read from disk one at a time.

    `dataset[i]`, iteration and `filter` never hold more than one trajectory. Reading a damaged file
    raises `DatasetError`, which names it; the others stay readable.
    """

    def __init__(
        self, path: Path, entries: Sequence[ManifestEntry], problems: Sequence[Problem] = ()
    ) -> None:
        self.path = path
        self.entries = tuple(entries)
        self.problems = tuple(problems)  # what `open(..., skip_damaged=True)` left out

    @classmethod
    def open(cls, path: Path | str, *, skip_damaged: bool = False) -> "Dataset":
        """The dataset in a folder.

        With `skip_damaged` every file is checked now; what is damaged is left out and listed in
        `problems`.

        Raises:
            DatasetError: no dataset, or without `skip_damaged` a manifest that is damaged or does
                not list the files that are there.
        """
        folder = Path(path)
        with locked(folder / manifest.LOCK, reading=True):
            entries, problems = read_manifest(folder)
        if skip_damaged:
            whole = cls(folder, entries)
            found = {entry: _trouble(whole, entry) for entry in entries}
            problems += [Problem(str(folder / e.file), what) for e, what in found.items() if what]
            return cls(folder, [entry for entry, what in found.items() if not what], problems)
        if problems:
            raise DatasetError(_summary(problems))
        return cls(folder, entries)

    def __len__(self) -> int:
        """The number of trajectories."""
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> Trajectory: ...

    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...

    def __getitem__(self, index: int | slice) -> "Trajectory | Dataset":
        """One trajectory, read and checked now; or some of the dataset."""
        if isinstance(index, slice):
            return Dataset(self.path, self.entries[index])
        return self.read(self.entries[index])

    def __iter__(self) -> Iterator[Trajectory]:
        """Read one trajectory after another."""
        return map(self.read, self.entries)

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {len(self)} trajectories)"

    def read(self, entry: ManifestEntry) -> Trajectory:
        """The trajectory of an entry; raises `DatasetError` naming the file if it is damaged."""
        path = self.path / entry.file
        raw = read_file(path)
        if hashlib.sha256(raw).hexdigest() != entry.sha256:
            raise DatasetError(
                f"{path}: expected {entry.size} bytes with SHA-256 {entry.sha256[:12]}..., found "
                f"{len(raw)} bytes with another; it was changed or cut after it was written"
            )
        try:
            trajectory = decode(raw)
        except DatasetError as error:
            raise DatasetError(f"{path}: {error}") from error
        if ManifestEntry.of(trajectory, raw, entry.index) != entry:
            raise DatasetError(f"{path}: the manifest says something else of it; {manifest.ADVICE}")
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
        """The trajectories for which everything given holds, without reading them.

        `min_score` compares the appendix's score, or where poses are unknown (human demonstrations)
        the published code's. Raises `UnknownNameError` for names that nothing has.
        """
        if task and all(task != entry.task for entry in self.entries):
            get_task(task)  # a task without demonstrations is well, a misspelt one is not
        if variant is not None and variant not in VARIANTS:
            raise UnknownNameError(
                f"{variant!r} is no variant; expected one of: {', '.join(VARIANTS)}"
            )
        wanted = env_id and parse_env_id(env_id).without_preset
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
        """`count` trajectories drawn without replacement, in the dataset's order.

        Raises `DatasetError` if there are fewer.
        """
        if count > len(self):
            raise DatasetError(f"{self.path}: expected {count} trajectories, found {len(self)}")
        chosen = sorted(rng.choice(len(self), count, replace=False).tolist())
        return Dataset(self.path, [self.entries[i] for i in chosen])

    def arrays(self, preset: Any = "LoRes4E") -> dict[str, Any]:
        """All steps as plain arrays; see `magical.demos.reader.dataset_arrays`."""
        from magical.demos.reader import (
            dataset_arrays,  # imports the renderer: only when needed
        )

        return dataset_arrays(self, preset)


def read_manifest(folder: Path) -> tuple[list[ManifestEntry], list[Problem]]:
    """What the manifest lists, and what is wrong with it or not in it; the caller holds the lock.

    Raises `DatasetError` if there is no manifest.
    """
    lines = list(manifest.read_entries(folder))
    entries = [line for line in lines if isinstance(line, ManifestEntry)]
    problems = [
        Problem(str(folder / manifest.NAME), str(error))
        for error in lines
        if isinstance(error, DatasetError)
    ]
    listed = {entry.file for entry in entries}
    present = sorted((folder / manifest.FOLDER).glob("*.npz"))
    problems += [
        Problem(str(path), f"not in the manifest; {manifest.ADVICE}")
        for path in present
        if f"{manifest.FOLDER}/{path.name}" not in listed
    ]
    return entries, problems


def read_file(path: Path) -> bytes:
    """A file's bytes; raises `DatasetError` naming it."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror or error}") from error


def _trouble(dataset: Dataset, entry: ManifestEntry) -> str:
    try:
        dataset.read(entry)
    except DatasetError as error:
        return str(error)
    return ""


def _summary(problems: Sequence[Problem]) -> str:
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{problems[0]}{more}; to use the rest: Dataset.open(..., skip_damaged=True)"
