"""Sources of episodes, addressed by short keys: the page never sends a path."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

from magical.demos.dataset import Dataset, Entry
from magical.demos.trajectory import Trajectory
from magical.errors import NotFoundError

ROLLOUTS = "rollouts"  # the key of a server's `RolloutSource`
MAX_ROLLOUTS = 50  # kept in memory; the oldest are dropped first


class DatasetSource:
    """A dataset on disk, which may grow while the server runs.

    Raises:
        DatasetError: the folder holds no dataset, or a damaged one.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self._folder = folder
        self._opened = lru_cache(1)(lambda _version: Dataset.open(folder))
        self._open()

    @property
    def version(self) -> object:
        """A value that changes whenever the dataset does."""
        return version_of(self._folder)

    def episodes(self) -> Mapping[int, Entry]:
        """The dataset's entries by episode number, oldest first."""
        return dict(enumerate(self._open().entries))

    def read(self, number: int) -> Trajectory:
        """The episode with a number; raises `NotFoundError` or `DatasetError`."""
        dataset = self._open()
        if 0 <= number < len(dataset):
            return dataset[number]
        raise NotFoundError(f"{self.name}: expected the number of an episode, found {number}")

    def _open(self) -> Dataset:
        return self._opened(self.version)


class RolloutSource:
    """Rollouts that the page requested, in memory; only the newest are kept."""

    name = "Rollouts of policies"
    version: object = None  # constant: episode numbers are never reused

    def __init__(self) -> None:
        self._episodes: Mapping[int, Trajectory] = {}  # replaced, never mutated: threads read it
        self._numbers = count()

    def add(self, episode: Trajectory) -> int:
        """Keep an episode; returns its number."""
        number = next(self._numbers)
        self._episodes = dict([*self._episodes.items(), (number, episode)][-MAX_ROLLOUTS:])
        return number

    def episodes(self) -> Mapping[int, Trajectory]:
        """All episodes by their numbers, oldest first."""
        return self._episodes

    def read(self, number: int) -> Trajectory:
        """The episode with a number; raises `NotFoundError`."""
        if episode := self._episodes.get(number):
            return episode
        raise NotFoundError(f"rollout {number} is no longer kept; roll out again")


def summary(number: int, episode: Trajectory | Entry) -> dict[str, Any]:
    """One row of the list of episodes, as plain JSON data."""
    return {
        "number": number,
        "env_id": episode.env_id,
        "score": episode.score,  # of the last state; None: poses unknown
        "published_code_score": episode.published_code_score,
        "demonstrator": episode.demonstrator,
        "seed": episode.seed,
    }


def unique_names(folders: Sequence[Path]) -> list[str]:
    """A name for each folder: its last part, with a number if an earlier one has the same."""
    names: list[str] = []
    for folder in folders:
        name = folder.resolve().name or "data"
        same = sum(other == name or other.startswith(f"{name} (") for other in names)
        names.append(f"{name} ({same + 1})" if same else name)
    return names


def version_of(path: Path) -> tuple[int, int] | None:
    """A value that changes whenever a file does; `None` if it cannot be accessed."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
