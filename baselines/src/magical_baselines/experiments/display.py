"""The live view of an execution, and the table of `magical status`."""

import shlex
import time
from collections.abc import Iterable
from operator import attrgetter
from pathlib import Path
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from magical.grouping import group_by
from magical.messages import for_terminal, printable
from magical.progress import LINE_INTERVAL, print_line
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.results import DONE, FAILED, Outcome
from magical_baselines.experiments.status import RUNNING, STATES, RunStatus, Status, read_status

MAX_COMMAND = 2_000  # characters of the command that continues a plan
DAYS = 2  # from so many on, durations are in days
SHOWN = 20  # the most runs in progress, and the most failed ones, that are listed


class Display:
    """A table on standard error, refreshed while a plan runs; plain lines without a terminal."""

    def __init__(self, path: Path) -> None:
        """Create a display of the results folder `path`."""
        self._path = path
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._last_line = time.monotonic()
        self._first: tuple[float, int] | None = None  # when training was seen to begin, and steps

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
        now = time.monotonic()
        due = now - self._last_line > LINE_INTERVAL
        if self._first and not (self._live.is_started or due):
            return
        status = read_status(self._path)
        left = self._time_left(status, now)
        if self._live.is_started:
            self._live.update(status_table(status, left), refresh=True)
        elif due:
            self._last_line = now
            self._print(_summary(status, left))

    def _time_left(self, status: Status, now: float) -> str:
        """In words: from the times of finished runs, or from the speed of the first ones."""
        done, total = status.steps
        if done and self._first is None:  # what came before is the start of processes
            self._first = now, done
        if status.seconds_left() is not None:
            return _time_left(status)
        began, before = self._first or (now, done)
        if not before < done < total:
            return ""
        seconds = (now - began) / (done - before) * (total - done)
        return f"about {duration(seconds)} of training left, then evaluation"

    def _print(self, *lines: str) -> None:
        for line in lines:
            print_line(self._console, line)


def status_table(status: Status, left: str = "") -> RenderableType:
    """The progress of a plan: counts by method, runs in progress, failed runs, time left.

    `left` is the time left in words, by default that of `Status.seconds_left`.
    """
    table = Table("method", *STATES, "runs", box=None, header_style="bold")
    for column in table.columns[1:]:
        column.justify = "right"
    groups = group_by(status.runs, attrgetter("method"))
    for method, runs in groups.items():
        _add_row(table, method, runs)
    if len(groups) > 1:
        _add_row(table, "all", status.runs)
    lines = _lines(status, left or _time_left(status))
    return Group(table, *(Text(for_terminal(line)) for line in lines))


def duration(seconds: float) -> str:
    """A duration as text, for instance `2:03:20`, or `12 days`."""
    if seconds >= DAYS * 86_400:
        return f"{round(seconds / 86_400):,} days"
    minutes, second = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{second:02}"


def _time_left(status: Status) -> str:
    left = status.seconds_left()
    return "" if left is None else f"about {duration(left)} left"


def _add_row(table: Table, name: str, runs: Iterable[RunStatus]) -> None:
    states = [run.state for run in runs]
    counts = [str(states.count(state) or "") for state in STATES]
    table.add_row(Text(for_terminal(name)), *counts, str(len(states)))


def _summary(status: Status, left: str) -> str:
    """The progress of a plan in one line."""
    failed = f", {status.counts[FAILED]} failed" if status.counts[FAILED] else ""
    done, total = status.steps
    return (
        f"{status.counts[DONE]} of {len(status.runs)} runs done{failed}, "
        f"{status.counts[RUNNING]} in progress, {done:,} of {total:,} steps"
        + (f", {left}" if left else "")
    )


def _lines(status: Status, left: str) -> Iterable[str]:
    yield ""
    running = [run for run in status.runs if run.state == RUNNING]
    for run in running[:SHOWN]:
        trained = "" if run.step < run.total else ": trained, is evaluated"
        yield f"running: {run}: {run.step:,} of {run.total:,} steps{trained}"
    failed = [run for run in status.runs if run.state == FAILED]
    for run in failed[:SHOWN]:
        yield f"failed: {run}: {run.error}"
    if len(failed) > SHOWN:
        yield f"failed: {len(failed) - SHOWN} more"
    yield from _others(status)
    if status.active and left:
        yield left
    elif not status.active and status.counts[DONE] + len(failed) < len(status.runs):
        words = shlex.join(["magical", *(status.command or ("run", "PLAN"))])
        again = printable(f"{words} --out {shlex.quote(str(status.path))}", MAX_COMMAND)
        yield f"no process is executing the plan; to continue it: {again}"


def _others(status: Status) -> Iterable[str]:
    if status.others:
        yield f"runs in the folder from an earlier plan or other demonstrations: {status.others}"
