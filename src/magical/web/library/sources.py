"""Where episodes come from, addressed by short keys: no path ever comes from the page."""

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from magical.demos.store import manifest
from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.trajectory import Trajectory
from magical.envs.ids import EnvId
from magical.errors import NotFoundError

MAX_ROLLOUTS = 50  # that are kept; the oldest are dropped first


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSummary:
    """One line of the list of episodes."""

    number: int  # in its source, for good
    env_id: EnvId
    length: int  # control steps
    score: float | None  # of the last state; None: poses unknown
    published_code_score: float
    demonstrator: str
    seed: int | None

    @staticmethod
    def of(number: int, episode: Trajectory | ManifestEntry) -> "EpisodeSummary":
        """The summary of an episode or of its entry in a manifest."""
        return EpisodeSummary(
            number=number,
            env_id=episode.env_id,
            length=episode.length if isinstance(episode, ManifestEntry) else len(episode),
            score=episode.score,
            published_code_score=episode.published_code_score,
            demonstrator=episode.demonstrator,
            seed=episode.seed,
        )


class Source(Protocol):
    """Episodes that the page can list and open."""

    name: str

    def summaries(self) -> Sequence[EpisodeSummary]:
        """All episodes, oldest first.

        Raises:
            DatasetError: they cannot be read.
        """

    def read(self, number: int) -> Trajectory:
        """The episode of a number.

        Raises:
            NotFoundError: there is none.
            DatasetError: it cannot be read.
        """


class DatasetSource:
    """A dataset on disk, which may grow meanwhile."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self._folder = folder
        self._version: tuple[int, int] | None = None  # of the manifest that was read last
        self._dataset: Dataset | None = None

    def summaries(self) -> Sequence[EpisodeSummary]:
        """See `Source`."""
        return [EpisodeSummary.of(entry.index, entry) for entry in self._open().entries]

    def read(self, number: int) -> Trajectory:
        """See `Source`."""
        dataset = self._open()
        for entry in dataset.entries:
            if entry.index == number:
                return dataset.read(entry)
        raise NotFoundError(f"{self.name}: expected the number of an episode, found {number}")

    def _open(self) -> Dataset:
        version = self._manifest_version()
        if self._dataset is None or version is None or version != self._version:
            self._dataset, self._version = Dataset.open(self._folder), version
        return self._dataset

    def _manifest_version(self) -> tuple[int, int] | None:
        try:
            found = (self._folder / manifest.NAME).stat()
        except OSError:
            return None  # opening the dataset says why
        return found.st_mtime_ns, found.st_size


class RolloutSource:
    """Episodes that policies were rolled out in for the page: in memory, the newest ones only."""

    name = "Rollouts of policies"

    def __init__(self, limit: int = MAX_ROLLOUTS) -> None:
        self._limit = limit
        self._episodes: OrderedDict[int, Trajectory] = OrderedDict()
        self._next = 0
        self._lock = threading.Lock()

    def add(self, episode: Trajectory) -> int:
        """Keep an episode; returns its number."""
        with self._lock:
            number, self._next = self._next, self._next + 1
            self._episodes[number] = episode
            while len(self._episodes) > self._limit:
                self._episodes.popitem(last=False)
            return number

    def summaries(self) -> Sequence[EpisodeSummary]:
        """See `Source`."""
        with self._lock:
            episodes = list(self._episodes.items())
        return [EpisodeSummary.of(number, episode) for number, episode in episodes]

    def read(self, number: int) -> Trajectory:
        """See `Source`."""
        with self._lock:
            if number in self._episodes:
                return self._episodes[number]
        raise NotFoundError(f"rollout {number} is not kept any more; roll out again")


ROLLOUTS = "rollouts"  # the key of a server's `RolloutSource`


class Sources:
    """All sources of a server by key: `d0`, `d1`, ... for datasets, and `rollouts`.

    Args:
        datasets: their folders.

    Raises:
        DatasetError: a folder holds no dataset, or a damaged one.
    """

    def __init__(self, datasets: Sequence[Path]) -> None:
        names = unique_names(datasets)
        found = [DatasetSource(*item) for item in zip(names, datasets, strict=True)]
        for dataset in found:
            dataset.summaries()
        self.rollouts = RolloutSource()
        self._sources: dict[str, Source] = {f"d{i}": dataset for i, dataset in enumerate(found)}
        self._sources[ROLLOUTS] = self.rollouts

    def __iter__(self) -> Iterator[tuple[str, Source]]:
        return iter(self._sources.items())

    def find(self, key: str) -> Source:
        """The source of a key; raises `NotFoundError`."""
        if key not in self._sources:
            raise NotFoundError(f"source: expected one of {', '.join(self._sources)}")
        return self._sources[key]


def unique_names(folders: Sequence[Path]) -> list[str]:
    """A name for each folder: its last part, and a number where another has the same."""
    names: list[str] = []
    for folder in folders:
        name = folder.resolve().name or "data"
        same = sum(other == name or other.startswith(f"{name} (") for other in names)
        names.append(f"{name} ({same + 1})" if same else name)
    return names
