"""The policies that the page offers: the scripted expert, and the runs in the given folders."""

import importlib
import threading
from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from magical.envs.action_spec import DISCRETE
from magical.envs.ids import EnvId
from magical.errors import MagicalError, NotFoundError, PolicyError, RunFolderError
from magical.evaluation.loading import load_policy
from magical.evaluation.policy import Policy, action_spec_of
from magical.experts import has_expert
from magical.runs import is_run, read_json
from magical.runs.folder import CHECKPOINT, CONFIG
from magical.tasks import TASKS
from magical_play.library.sources import unique_names, version_of

EXPERT = 0  # the number of the scripted expert
EXPERT_NAME = "expert"  # also the demonstrator of its episodes
MAX_DEPTH = 3  # levels of folders below a given one that are searched for runs
MAX_LOADED = 4  # policies kept in memory


@dataclass(frozen=True, slots=True)
class PolicyEntry:
    """A policy that can be watched or rolled out."""

    name: str
    tasks: tuple[str, ...]  # in which it can act
    algorithm: str | None = None  # None: the scripted expert
    folder: Path | None = None

    def check(self, env_id: EnvId) -> None:
        """Raise `PolicyError` if the policy cannot act in an environment."""
        if env_id.task not in self.tasks:
            raise PolicyError(
                f"{self.name}: expected an environment of the tasks it can act in, "
                f"{', '.join(self.tasks)}; found {env_id}"
            )


class Policies:
    """The policies of a server by number: 0 is the expert, then runs in the order they were found.

    Args:
        folders: run folders, or folders with run folders in them.
        tasks: tasks to offer besides the registered ones, such as generated ones.

    Raises:
        RunFolderError: a folder does not exist.
    """

    def __init__(self, folders: Sequence[Path] = (), tasks: Sequence[str] = ()) -> None:
        for folder in folders:
            if not folder.is_dir():
                raise RunFolderError(f"{folder}: expected a folder with runs, found none")
        names = unique_names(folders) if len(folders) > 1 else [""] * len(folders)
        self._folders = list(zip(names, folders, strict=True))
        self._tasks = (*TASKS, *tasks)
        self._entries = [PolicyEntry(EXPERT_NAME, ())]
        self._load = lru_cache(MAX_LOADED)(lambda folder, _: load_policy(folder.absolute()))
        self._lock = threading.Lock()  # for the list, and so that no run is loaded twice at once
        if folders:
            with suppress(ImportError):  # a later import would hold up all players for seconds
                importlib.import_module("magical_baselines.policy")
        self.refresh()

    def refresh(self) -> Sequence[PolicyEntry]:
        """All policies, including runs that were added since; numbers do not change."""
        with self._lock:
            known = {entry.folder for entry in self._entries}
            for name, root in self._folders:
                for folder in find_runs(root):
                    if folder not in known:
                        self._entries.append(_entry(name, root, folder))
                        known.add(folder)
            self._entries[EXPERT] = PolicyEntry(EXPERT_NAME, tuple(filter(has_expert, self.tasks)))
            return tuple(self._entries)

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks to offer: registered ones, and others that were given or that a run learned."""
        learned = (task for entry in self._entries for task in entry.tasks)
        return tuple(dict.fromkeys((*self._tasks, *learned)))

    def find(self, number: int) -> PolicyEntry:
        """The policy with a number; raises `NotFoundError`."""
        count = len(self._entries)
        if not 0 <= number < count:
            raise NotFoundError(f"policy: expected one of {count}, found number {number}")
        return self._entries[number]

    def load(self, number: int) -> Policy:
        """A run's policy, from its newest checkpoint; the first call takes seconds.

        Every call returns a copy with its own episode state.

        Raises:
            PolicyError: the policy is the expert, which has no network, or has continuous actions.
            RunFolderError, CheckpointError: the run is damaged, or has no checkpoint yet.
            MissingDependencyError: PyTorch is not installed.
        """
        entry = self.find(number)
        if entry.folder is None:
            raise PolicyError(f"{entry.name}: has no action probabilities; choose a run")
        with self._lock:
            policy = copy(self._load(entry.folder, version_of(entry.folder / CHECKPOINT)))
        if action_spec_of(policy) is not DISCRETE:
            raise PolicyError(f"{entry.name}: its actions are continuous; choose one with discrete")
        return policy


def find_runs(root: Path) -> list[Path]:
    """The run folders at or below a folder, at most `MAX_DEPTH` levels deep, in order."""
    if is_run(root):
        return [root]
    patterns = ("/".join(["*"] * depth + [CONFIG]) for depth in range(1, MAX_DEPTH + 1))
    return sorted(path.parent for pattern in patterns for path in root.glob(pattern))


def _entry(name: str, root: Path, folder: Path) -> PolicyEntry:
    """The entry of a run in a given folder; `name` is empty if only one folder was given."""
    parts = [name, *folder.relative_to(root).parts]
    shown = "/".join(filter(None, parts)) or root.resolve().name
    try:
        config = read_json(folder / CONFIG)
        tasks = tuple(task for task in config["tasks"] if task in TASKS)
        return PolicyEntry(shown, tasks, str(config["algorithm"]), folder)
    except (MagicalError, LookupError, TypeError):
        return PolicyEntry(f"{shown} (damaged)", (), "unknown", folder)
