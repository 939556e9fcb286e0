"""The live view of an execution, and the table of `magical status`."""

import time
from collections.abc import Iterable
from datetime import timedelta
from operator import attrgetter
from pathlib import Path
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from magical.experiments.plan import PlannedRun
from magical.experiments.results import DONE, FAILED, Outcome
from magical.experiments.status import RUNNING, STATES, RunStatus, Status, read_status
from magical.grouping import group_by
from magical.messages import for_terminal
from magical.progress import LINE_INTERVAL, print_line

SHOWN = 20  # the most runs in progress, and the most failed ones, that are listed


class Display:
    """A table on standard error, refreshed while a plan runs; plain lines without a terminal."""

    def __init__(self, path: Path) -> None:
        """Create a display of the results folder `path`."""
        self._path = path
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._last_line = time.monotonic()

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        else:
            self._print(*_others(read_status(self._path)))
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def ended(self, run: PlannedRun, outcome: Outcome) -> None:
        """Print a line about a run that has ended."""
        took = f" ({duration(outcome.seconds)})" if outcome.seconds else ""
        error = f": {outcome.error}" if outcome.error else ""
        self._print(f"{outcome.state}: {run}{took}{error}")

    def refresh(self) -> None:
        """Show the current state; without a terminal, only every `LINE_INTERVAL` seconds."""
        if self._live.is_started:
            self._live.update(status_table(read_status(self._path)), refresh=True)
        elif time.monotonic() - self._last_line > LINE_INTERVAL:
            self._last_line = time.monotonic()
            self._print(_summary(read_status(self._path)))

    def _print(self, *lines: str) -> None:
        for line in lines:
            print_line(self._console, line)


def status_table(status: Status) -> RenderableType:
    """The progress of a plan: counts by method, runs in progress, failed runs, time left."""
    table = Table("method", *STATES, "runs", box=None, header_style="bold")
    for column in table.columns[1:]:
        column.justify = "right"
    groups = group_by(status.runs, attrgetter("method"))
    for method, runs in groups.items():
        _add_row(table, method, runs)
    if len(groups) > 1:
        _add_row(table, "all", status.runs)
    return Group(table, *(Text(for_terminal(line)) for line in _lines(status)))


def duration(seconds: float) -> str:
    """A duration as text, for instance `2:03:20`."""
    return str(timedelta(seconds=round(seconds)))


def _add_row(table: Table, name: str, runs: Iterable[RunStatus]) -> None:
    states = [run.state for run in runs]
    counts = [str(states.count(state) or "") for state in STATES]
    table.add_row(Text(for_terminal(name)), *counts, str(len(states)))


def _summary(status: Status) -> str:
    """The progress of a plan in one line."""
    failed = f", {status.counts[FAILED]} failed" if status.counts[FAILED] else ""
    left = status.seconds_left()
    return (
        f"{status.counts[DONE]} of {len(status.runs)} runs done{failed}, "
        f"{status.counts[RUNNING]} in progress"
        + (f", about {duration(left)} left" if left is not None else "")
    )


def _lines(status: Status) -> Iterable[str]:
    yield ""
    running = [run for run in status.runs if run.state == RUNNING]
    for run in running[:SHOWN]:
        yield f"running: {run}: {run.step} of {run.total}"
    failed = [run for run in status.runs if run.state == FAILED]
    for run in failed[:SHOWN]:
        yield f"failed: {run}: {run.error}"
    if len(failed) > SHOWN:
        yield f"failed: {len(failed) - SHOWN} more"
    yield from _others(status)
    left = status.seconds_left()
    if status.active and left is not None:
        yield f"time left: about {duration(left)}"
    elif not status.active and status.counts[DONE] + len(failed) < len(status.runs):
        yield "no process is executing the plan; to continue it: magical run"


def _others(status: Status) -> Iterable[str]:
    if status.others:
        yield f"runs in the folder from an earlier plan or other demonstrations: {status.others}"
