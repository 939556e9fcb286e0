"""The policies that the page offers: the scripted expert, and the runs in given folders."""

import importlib
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.store.reader import ObservationReader
from magical.demos.store.trajectory import Trajectory
from magical.envs.ids import EnvId
from magical.errors import (
    MagicalError,
    MissingDependencyError,
    NotFoundError,
    PolicyError,
    RunFolderError,
)
from magical.evaluation.loading import load_policy
from magical.evaluation.policy import Policy
from magical.experts import has_expert
from magical.runs import is_run
from magical.runs.folder import CHECKPOINT, CONFIG, read_json
from magical.tasks import TASKS
from magical.web.library.sources import unique_names

EXPERT = 0  # the number of the scripted expert
EXPERT_NAME = "expert"  # also the demonstrator of its episodes
MAX_DEPTH = 3  # folders below a given one in which runs are looked for
MAX_RUNS = 500  # that are listed
MAX_LOADED = 4  # policies that are kept in memory
BATCH = 32  # steps whose probabilities are computed at once


@dataclass(frozen=True, slots=True)
class PolicyEntry:
    """A policy that can be watched or rolled out."""

    name: str
    tasks: tuple[str, ...]  # that it can act in
    algorithm: str | None = None  # None: the scripted expert
    folder: Path | None = None

    def check(self, env_id: EnvId) -> None:
        """Raise `PolicyError` where it cannot act in an environment."""
        if env_id.task not in self.tasks:
            raise PolicyError(
                f"{self.name}: expected an environment of the tasks it can act in, "
                f"{', '.join(self.tasks)}; found {env_id}"
            )


class Policies:
    """The policies of a server by number: 0 is the expert, then runs in the order of finding them.

    Args:
        folders: run folders, or folders with run folders in them.

    Raises:
        RunFolderError: there is no such folder.
    """

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        for folder in folders:
            if not folder.is_dir():
                raise RunFolderError(f"{folder}: expected a folder with runs, found none")
        names = unique_names(folders) if len(folders) > 1 else [""] * len(folders)
        self._folders = dict(zip(names, folders, strict=True))
        self._entries = [PolicyEntry(EXPERT_NAME, tuple(filter(has_expert, TASKS)))]
        self._loaded: dict[tuple[int, int], Policy] = {}  # by number, and time of the checkpoint
        self._lock = threading.Lock()
        if folders:
            _import_learning()
        self.refresh()

    def __len__(self) -> int:
        return len(self._entries)

    def refresh(self) -> Sequence[PolicyEntry]:
        """All policies, with runs that were added meanwhile; numbers stay what they are."""
        with self._lock:
            known = {entry.folder for entry in self._entries}
            for name, root in self._folders.items():
                for folder in find_runs(root):
                    if folder not in known and len(self._entries) <= MAX_RUNS:
                        self._entries.append(_entry(name, root, folder))
                        known.add(folder)
            return tuple(self._entries)

    def find(self, number: int) -> PolicyEntry:
        """The policy of a number; raises `NotFoundError`."""
        if not 0 <= number < len(self._entries):
            raise NotFoundError(f"policy: expected one of {len(self)}, found number {number}")
        return self._entries[number]

    def load(self, number: int) -> Policy:
        """A run's policy, from its newest checkpoint; takes seconds for the first one.

        Raises:
            PolicyError: it is the expert, which is no network.
            RunFolderError, CheckpointError: the run is damaged, or has no checkpoint yet.
            MissingDependencyError: PyTorch is not installed.
        """
        entry = self.find(number)
        if entry.folder is None:
            raise PolicyError(f"{entry.name}: has no action probabilities; choose a run")
        with self._lock:
            key = number, _changed_at(entry.folder / CHECKPOINT)
            if key not in self._loaded:
                self._loaded[key] = load_policy(entry.folder)
                for old in list(self._loaded)[:-MAX_LOADED]:
                    del self._loaded[old]
            return self._loaded[key]


def _import_learning() -> None:
    """Import PyTorch, where it is installed: later it would hold up all players for seconds."""
    from magical.extras import require

    with suppress(MissingDependencyError):
        require("learning")
        importlib.import_module("magical.learning.policy")


def find_runs(root: Path) -> list[Path]:
    """The run folders at or below a folder, at most `MAX_DEPTH` levels deep, in order."""
    if is_run(root):
        return [root]
    patterns = ("/".join(["*"] * depth + [CONFIG]) for depth in range(1, MAX_DEPTH + 1))
    return sorted(path.parent for pattern in patterns for path in root.glob(pattern))


def _entry(name: str, root: Path, folder: Path) -> PolicyEntry:
    """The entry of a run below one of the given folders, whose name is empty if it is the only."""
    parts = [name, *folder.relative_to(root).parts]
    shown = "/".join(filter(None, parts)) or root.resolve().name
    try:
        config = read_json(folder / CONFIG)
        tasks = tuple(task for task in config["tasks"] if task in TASKS)
        return PolicyEntry(shown, tasks, str(config["algorithm"]), folder)
    except (MagicalError, LookupError, TypeError):
        return PolicyEntry(f"{shown} (damaged)", (), "unknown", folder)


def _changed_at(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0  # loading says why


def act_on_one_thread(policy: Policy, *arguments: Any) -> int:
    """The action of a run's policy in one environment.

    One thread is faster for a single observation, and leaves the other cores to the players.
    """
    from magical.learning.running.devices import one_thread  # imports PyTorch: only for runs

    with one_thread():
        return int(policy.act(*arguments)[0])


def probabilities(policy: Any, observations: Any, env_ids: Sequence[EnvId]) -> NDArray[np.float64]:
    """A run's distributions over actions, (B, 18), computed on one thread."""
    from magical.learning.running.devices import one_thread

    with one_thread():
        found: NDArray[np.float64] = policy.probabilities(observations, env_ids)
        return found


def episode_probabilities(policy: Any, episode: Trajectory) -> NDArray[np.float64]:
    """A run's distributions over actions before each step of an episode, (T, 18).

    Raises:
        PolicyError: the policy did not learn the episode's task.
        TrajectoryError, ObservationError: the episode does not have the policy's observations.
    """
    reader = ObservationReader(episode, policy.observation)
    parts = []
    for first in range(0, len(episode), BATCH):
        times = range(first, min(first + BATCH, len(episode)))
        env_ids = [episode.env_id] * len(times)
        parts.append(probabilities(policy, reader.read(list(times)), env_ids))
    return np.concatenate(parts)
