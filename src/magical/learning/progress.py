"""What is said while a run learns: on standard error, as a bar where somebody watches."""

import time
from collections.abc import Mapping
from typing import Protocol, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

QUIET_INTERVAL = 30.0  # s between lines where nobody watches


class Progress(Protocol):
    """Is told of every report of a run."""

    def update(self, step: int, total: int, metrics: Mapping[str, float | str]) -> None:
        """`step` of `total` batches or updates are done."""


class Silent:
    """Says nothing."""

    def update(self, step: int, total: int, metrics: Mapping[str, float | str]) -> None:
        """Nothing."""


class ProgressBar:
    """A bar with the newest metrics and the time left; a line now and then without a terminal."""

    def __init__(self, title: str) -> None:
        console = Console(stderr=True)
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            MofNCompleteColumn(),
            TextColumn("{task.fields[metrics]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._title = title
        self._task = self._bar.add_task(title, total=None, metrics="")
        self._said = 0.0

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def update(self, step: int, total: int, metrics: Mapping[str, float | str]) -> None:
        """Show the newest metrics."""
        text = "  ".join(_said(name, value) for name, value in metrics.items())
        self._bar.update(self._task, completed=step, total=total, metrics=text)
        now = time.monotonic()
        if self._bar.disable and (step == total or now - self._said > QUIET_INTERVAL):
            self._said = now
            self._bar.console.print(f"{self._title} {step}/{total}  {text}", highlight=False)


def _said(name: str, value: float | str) -> str:
    return f"{name}: {value}" if isinstance(value, str) else f"{name} {value:.3g}"
