"""The progress of a plan's runs, from the files of a results folder alone."""

from collections import Counter
from dataclasses import asdict, dataclass
from operator import itemgetter
from pathlib import Path
from statistics import mean
from typing import Any

from magical.errors import ResultsError, RunFolderError
from magical.experiments.results import (
    DONE,
    EXPERIMENT,
    FAILED,
    PROGRESS,
    WAITING,
    RunsInProgress,
    is_results,
    read_result,
    run_folders,
)
from magical.files import LOCK, is_locked
from magical.grouping import group_by
from magical.runs.metrics import read_metrics
from magical.runs.plan import MAX_BYTES, RUNS, ListedRun, read_listing
from magical.untrusted import read_json

RUNNING = "running"
STATES = (DONE, FAILED, RUNNING, WAITING)


@dataclass(frozen=True, slots=True)
class RunStatus(ListedRun):
    """The progress of one run.

    Attributes:
        state: one of `STATES`; an interrupted run is `waiting`.
        step: batches or updates done, from the newest line of metrics; 0 for a run that has ended.
        seconds: how long the last session of training and the evaluation took, if it is done.
        error: the message, if it failed.
    """

    state: str
    step: int
    seconds: float | None = None
    error: str = ""


@dataclass(frozen=True, slots=True)
class Status:
    """The progress of a plan.

    Attributes:
        path: the results folder.
        active: whether a process is executing the plan.
        slots: how many runs it executes at a time.
        runs: every run, in the plan's order.
        others: the number of runs in the folder that are no longer in the plan.
        command: the words of the command that continues the plan, but for the folder.
    """

    path: Path
    active: bool
    slots: int
    runs: tuple[RunStatus, ...]
    others: int
    command: tuple[str, ...] = ()

    @property
    def counts(self) -> Counter[str]:
        """The number of runs by state."""
        return Counter(run.state for run in self.runs)

    @property
    def steps(self) -> tuple[int, int]:
        """The steps of training that are done, and all, of the runs that have not failed."""
        runs = [run for run in self.runs if run.state != FAILED]
        done = sum(run.total if run.state == DONE else run.step for run in runs)
        return done, sum(run.total for run in runs)

    def seconds_left(self) -> float | None:
        """An estimate from the times of finished runs; `None` while there are none.

        A run is expected to take the mean of its method's finished runs, or of all.
        """
        times = [(run.method, run.seconds) for run in self.runs if run.seconds is not None]
        if not times:
            return None
        overall = mean(seconds for _, seconds in times)
        groups = group_by(times, itemgetter(0)).items()
        means = {method: mean(seconds for _, seconds in group) for method, group in groups}
        left = [
            means.get(run.method, overall) * (1 - run.step / max(1, run.total))
            for run in self.runs
            if run.state in (RUNNING, WAITING)
        ]
        return max([sum(left) / max(1, self.slots), *left])

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "out": str(self.path),
            "active": self.active,
            "runs": len(self.runs),
            **{state: self.counts[state] for state in STATES},
            "others": self.others,
            "seconds_left": self.seconds_left(),
            "failures": {run.folder: run.error for run in self.runs if run.state == FAILED},
        }


def read_status(folder: Path | str) -> Status:
    """Read the progress of a plan without disturbing its execution.

    Args:
        folder: the results folder.

    Raises:
        ResultsError: not a results folder, or a damaged one.
    """
    path = Path(folder)
    if not is_results(path):
        raise ResultsError(
            f"{path}: expected a results folder with {EXPERIMENT} (`magical run PLAN --out DIR` "
            "makes one), found none"
        )
    active = is_locked(path / LOCK)
    progress = RunsInProgress()
    if active and (path / PROGRESS).exists():
        progress = read_json(path / PROGRESS, RunsInProgress, ResultsError, max_bytes=MAX_BYTES)
    listing = read_listing(path)
    runs = tuple(_run_status(path, run, run.folder in progress.running) for run in listing.runs)
    others = {folder.name for folder in run_folders(path)} - {run.folder for run in runs}
    return Status(path, active, progress.slots, runs, len(others), listing.command)


def _run_status(path: Path, run: ListedRun, running: bool) -> RunStatus:
    folder = path / RUNS / run.folder
    step = 0
    try:
        record = read_result(folder)
        if not record and (rows := read_metrics(folder)):
            step = int(rows[-1]["step"])
    except (ResultsError, RunFolderError) as damage:
        record = {"state": FAILED, "error": str(damage)}
    seconds = record.get("seconds")
    times = list(seconds.values()) if isinstance(seconds, dict) else []
    return RunStatus(
        **asdict(run),
        state=record.get("state") or (RUNNING if running else WAITING),
        step=step,
        seconds=sum(times) if times and all(isinstance(t, int | float) for t in times) else None,
        error=str(record.get("error", "")),
    )
