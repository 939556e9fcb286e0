"""The progress display of all commands: a bar on standard error."""

import sys
import time
from collections.abc import Mapping
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LINE_INTERVAL = 30.0  # seconds between lines if standard error is not a terminal


class ProgressBar:
    """A bar with a count, the time left and, in `update`, metrics; it disappears at the end.

    Without a terminal, a line is printed every `LINE_INTERVAL` seconds instead, and one at the last
    `update`.
    """

    def __init__(self, title: str, total: int, *, transient: bool = True) -> None:
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
        text = "  ".join(
            f"{name}: {value}" if isinstance(value, str) else f"{name} {value:.3g}"
            for name, value in metrics.items()
        )
        self._progress.update(self._task, completed=step, metrics=text)
        self._print_line(text, at_once=self._progress.finished)

    def _print_line(self, text: str, at_once: bool = False) -> None:
        now = time.monotonic()
        if self._progress.disable and (at_once or now - self._last_line > LINE_INTERVAL):
            self._last_line, task = now, self._progress.tasks[0]
            done = f"{task.description} {task.completed:.0f}/{task.total:.0f}"
            print(f"{done}  {text}".rstrip(), file=sys.stderr)
