"""Trackers, one per file: where the metrics of a run go in addition to its folder.

Each file opens a session of its library for a run, and ends with `TRACKER = Tracker(...)`. Trackers
of other distributions are found by entry points of the group `magical.trackers`, and all others by
`module:NAME`.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.plugins import Registry
from magical.runs.folder import CONFIG, RECORD, read_json

Log = Callable[[int, Mapping[str, float]], object]  # step, metrics that are numbers
LogAll = Callable[[int, Mapping[str, float | str]], object]  # step, metrics


@dataclass(frozen=True, slots=True)
class TrackedRun:
    """What a tracker is told about a run.

    Attributes:
        folder: the run folder; its name is the run's.
        id: 32 hexadecimal digits, the same whenever the run is resumed.
        config: the configuration as plain data.
        step: the step of the checkpoint that training continues from, 0 in a new run. Metrics of
            later steps that the tracker already has are logged again.
    """

    folder: Path
    id: str
    config: Mapping[str, Any]
    step: int

    @staticmethod
    def of(folder: Path, step: int) -> "TrackedRun":
        """The run in a folder, whose training continues from a step."""
        config, began = read_json(folder / CONFIG), read_json(folder / RECORD).get("began")
        sha = hashlib.sha256(f"{folder.resolve().name} {began} {config}".encode())
        return TrackedRun(folder, sha.hexdigest()[:32], config, step)

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.resolve().name


@dataclass(frozen=True, slots=True)
class Tracker:
    """A tracker, as defined in each file of this folder.

    Attributes:
        open: a function from a run to a context manager, whose value is called as
            `log(step, metrics)` with the numeric metrics after each line of metrics.
    """

    open: Callable[[TrackedRun], AbstractContextManager[Log]]


_TRACKERS = Registry("tracker", Tracker, "magical.trackers", __name__, "TRACKER")


def tracker_names() -> list[str]:
    """The sorted names of all trackers, of this and other distributions; imports none."""
    return _TRACKERS.names()


@contextmanager
def opened_trackers(names: Sequence[str], folder: Path, step: int) -> Iterator[LogAll]:
    """Context manager that opens sessions of these trackers for a run; its value logs to all.

    Raises:
        UnknownNameError: there is no tracker with one of the names.
        MissingDependencyError: a tracker's library is not installed.
    """
    trackers = [_TRACKERS.get(name) for name in names]
    with ExitStack() as stack:
        logs = [stack.enter_context(each.open(TrackedRun.of(folder, step))) for each in trackers]

        def log(step: int, metrics: Mapping[str, float | str]) -> None:
            numbers = {name: v for name, v in metrics.items() if not isinstance(v, str)}
            for one in logs if numbers else ():
                one(step, numbers)

        yield log
