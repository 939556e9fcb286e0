"""The states of a plan's runs, from the files of its results folder alone (docs/experiments.md)."""

import shlex
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from magical.errors import MagicalError, RunFolderError
from magical.evaluation.entry import ENTRY_FILE
from magical.files import LOCK, read_json
from magical.messages import printable, quoted
from magical.runs import PLAN, REFERENCES, RESULT, RUNS, ListedRun, read_listing, read_metrics
from magical_baselines.run_folder import is_locked

DEMOS = "demos"  # in the results folder, as is `LOCK`
DONE, FAILED = "done", "failed"  # states in `result.json`
RUNNING, WAITING = "running", "waiting"  # a run without `result.json`, in progress or not
STATES = (DONE, FAILED, RUNNING, WAITING)


@dataclass(frozen=True, slots=True)
class RunStatus(ListedRun):
    """The progress of one run."""

    state: str  # one of `STATES`; an interrupted run is `waiting`
    step: int = 0  # batches or updates done, from the newest line of metrics
    error: str = ""  # the message, if it failed

    @property
    def progress(self) -> str:
        """An error, or how far training is."""
        return f"{self.step:,} of {self.total:,}" if self.step else self.error


@dataclass(frozen=True, slots=True)
class Status:
    """The progress of a plan."""

    path: Path
    active: bool  # whether a process is executing the plan
    runs: tuple[RunStatus, ...]  # in the plan's order
    references: int  # the number of reference policies that are not evaluated yet
    command: tuple[str, ...] = ()  # that continues the plan, but for the folder

    @property
    def counts(self) -> Counter[str]:
        return Counter(run.state for run in self.runs)

    @property
    def complete(self) -> bool:
        return self.counts[DONE] == len(self.runs) and not self.references

    def __str__(self) -> str:
        """One line: what is done, and what to do about the rest."""
        counts = self.counts
        text = f"{self.path}: {counts[DONE]} of {len(self.runs)} runs done"
        text += "".join(f", {counts[state]} {state}" for state in STATES[1:] if counts[state])
        if self.references:
            text += f", {self.references} reference policies left to evaluate"
        if self.active or self.complete:
            return text
        words = [*(self.command or ("run", "PLAN")), "--out", str(self.path)]
        again = ["--retry-failed"] * (counts[FAILED] > 0)
        return f"{text}; to continue: {printable(shlex.join(['magical', *words, *again]), 2_000)}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "out": str(self.path),
            "active": self.active,
            "runs": len(self.runs),
            **{state: self.counts[state] for state in STATES},
            "plan": [asdict(run) for run in self.runs],
        }


def read_status(folder: Path | str) -> Status:
    """Read the progress of a plan in a results folder, without disturbing its execution.

    Raises `RunFolderError`: not a results folder, or a damaged one.
    """
    path = Path(folder)
    if not (path / PLAN).is_file():
        raise RunFolderError(f"{path}: expected a results folder of `magical run`, found no {PLAN}")
    listing = read_listing(path)
    runs = tuple(_status(path / RUNS / run.folder, run) for run in listing.runs)
    entries = (path / REFERENCES / name / ENTRY_FILE for name in listing.references or ())
    left = sum(not entry.is_file() for entry in entries)
    return Status(path, is_locked(path / LOCK), runs, left, listing.command)


def _status(folder: Path, run: ListedRun) -> RunStatus:
    listed = asdict(run)
    try:
        if record := read_result(folder):
            return RunStatus(**listed, state=record["state"], error=str(record.get("error", "")))
        rows = read_metrics(folder)
        state = RUNNING if is_locked(lock_of(folder)) else WAITING
        return RunStatus(**listed, state=state, step=rows[-1]["step"] if rows else 0)
    except (MagicalError, OSError, ValueError) as damage:  # also a name that is not a folder's
        return RunStatus(**listed, state=FAILED, error=str(damage))


def read_result(folder: Path) -> dict[str, Any]:
    """A run's final record, with its `state`; empty without one; `RunFolderError` if damaged."""
    if not (folder / RESULT).is_file():
        return {}
    record = read_json(folder / RESULT, dict[str, Any], RunFolderError)
    if (state := record.get("state")) not in (DONE, FAILED):
        found = f"expected {DONE} or {FAILED}, found {quoted(state)}"
        raise RunFolderError(f"{folder / RESULT}: state: {found}; remove the file")
    return record


def lock_of(folder: Path) -> Path:
    """The lock of a run, beside its folder: training removes a folder that holds nothing yet."""
    return folder.with_name(f".{folder.name}.lock")
