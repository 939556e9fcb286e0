"""The progress display of all commands: a bar on standard error."""

import time
from collections.abc import Mapping
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LINE_INTERVAL = 30.0  # seconds between lines if standard error is not a terminal


class ProgressBar:
    """A bar with a count, the time left and, in `update`, metrics.

    Without a terminal, a line is printed every `LINE_INTERVAL` seconds instead, and one at the last
    `update`.
    """

    def __init__(self, title: str, total: int, *, transient: bool = True) -> None:
        """`transient` bars disappear when they are closed."""
        console = Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            MofNCompleteColumn(),
            TextColumn("{task.fields[metrics]}"),
            TimeRemainingColumn(),
            console=console,
            transient=transient,
            disable=not console.is_terminal,
        )
        self._title, self._total = title, total
        self._task = self._progress.add_task(title, total=total, metrics="")
        self._last_line = time.monotonic()

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._progress.stop()

    def advance(self, count: int = 1) -> None:
        """Advance the bar by `count`."""
        self._progress.advance(self._task, count)
        self._print_line("")

    def update(self, step: int, metrics: Mapping[str, float | str]) -> None:
        """Show that `step` steps are done, and the latest metrics."""
        text = "  ".join(_format(name, value) for name, value in metrics.items())
        self._progress.update(self._task, completed=step, metrics=text)
        self._print_line(text, at_once=step == self._total)

    def _print_line(self, text: str, at_once: bool = False) -> None:
        now = time.monotonic()
        if self._progress.disable and (at_once or now - self._last_line > LINE_INTERVAL):
            self._last_line = now
            done = f"{self._progress.tasks[0].completed:.0f}/{self._total}"
            print_line(self._progress.console, f"{self._title} {done}  {text}".rstrip())


def print_line(console: Console, line: str) -> None:
    """Print a line unchanged, however long."""
    console.print(line, highlight=False, markup=False, soft_wrap=True)


def _format(name: str, value: float | str) -> str:
    return f"{name}: {value}" if isinstance(value, str) else f"{name} {value:.3g}"
