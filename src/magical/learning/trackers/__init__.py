"""Trackers, a file each: where the metrics of a run go besides its folder.

Such a file opens a session of its library for a run, and at its end has `TRACKER = Tracker(...)`.
Those of other distributions are found by entry points of the group `magical.trackers`, and any
other by `module:NAME`.
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
    """What a tracker is told of a run.

    Attributes:
        folder: the run folder; its name is the run's.
        id: 32 hexadecimal digits, the same whenever the run is resumed.
        config: the configuration as plain data.
        step: the steps behind the checkpoint that training continues from, 0 in a new run. Metrics
            of later steps that the tracker already has are logged again.
    """

    folder: Path
    id: str
    config: Mapping[str, Any]
    step: int

    @staticmethod
    def of(folder: Path, step: int) -> "TrackedRun":
        """The run of a folder that training continues from a step."""
        config, began = read_json(folder / CONFIG), read_json(folder / RECORD).get("began")
        sha = hashlib.sha256(f"{folder.resolve().name} {began} {config}".encode())
        return TrackedRun(folder, sha.hexdigest()[:32], config, step)

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.resolve().name


@dataclass(frozen=True, slots=True)
class Tracker:
    """What a file of this folder offers.

    Attributes:
        open: a function from a run to a context manager, whose value is called as
            `log(step, metrics)` after each line of metrics, with those that are numbers.
    """

    open: Callable[[TrackedRun], AbstractContextManager[Log]]


_TRACKERS = Registry("tracker", Tracker, "magical.trackers", __name__, "TRACKER")


def tracker_names() -> list[str]:
    """Every tracker, of this and of other distributions, alphabetically; imports none."""
    return _TRACKERS.names()


@contextmanager
def opened_trackers(names: Sequence[str], folder: Path, step: int) -> Iterator[LogAll]:
    """Open sessions of the trackers of these names, for a run; the value logs to all of them.

    Raises:
        UnknownNameError: there is no tracker of a name.
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
