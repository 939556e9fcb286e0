"""Learning curves from the metrics of runs."""

import importlib.util
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magical.errors import RunFolderError
from magical.evaluation.intervals import Floats
from magical.files import write_atomically
from magical.report.figures.plots import (
    legend,
    legend_height,
    line_style,
    new_figure,
    plotting,
    svg,
    tidy,
)
from magical.report.found.search import Result
from magical.runs.folder import CURVES
from magical.runs.metrics import read_metrics
from magical.runs.plan import in_words

PANELS = ("loss", "accuracy", "score")  # of a page, if the metrics have them
SMOOTHING = 50  # rows of metrics in the moving average, at most a tenth of all
MAX_POINTS = 200  # of a curve, roughly: it may have up to twice as many
LARGEST = 1e300  # numbers from here on are not plotted
NOT_PLOTTED = ("step", "environment_steps", "warning")
COLUMNS = 4  # of the figure of `save_learning_curves`

MetricRows = Sequence[Mapping[str, Any]]


def curves_by_task(
    results: Sequence[Result],
) -> tuple[dict[str, list[str]], dict[Path, str]]:
    """Learning curves: a figure for each task and quantity, with a line for each training run.

    Args:
        results: evaluated runs. Those without a training run, or whose run has no metrics, are
            left out. A method's position among all methods determines its colour.

    Returns:
        The figures as SVG by task, and the errors of damaged metrics by folder.
    """
    methods = list(dict.fromkeys(result.entry.method for result in results))
    runs = {result.run: result for result in results if result.run is not None}
    groups: dict[str, list[tuple[str, MetricRows]]] = {}
    damaged = {}
    for folder, result in runs.items():
        try:
            if rows := read_metrics(folder):
                groups.setdefault(_trained_on(result), []).append((result.entry.method, rows))
        except RunFolderError as error:
            damaged[folder] = str(error)
    figures: dict[str, list[str]] = {}
    for number, (task, of_task) in enumerate(groups.items()):
        for key in PANELS:
            name = f"curve-{number}-{key}"
            if picture := _panel(of_task, key, methods, f"{key} on {task}", name):
                figures.setdefault(task, []).append(picture)
    return figures, damaged


def _trained_on(result: Result) -> str:
    """The tasks that a run was trained on, in words."""
    recorded = result.config.get("tasks")
    known = isinstance(recorded, list) and recorded
    return in_words(tuple(map(str, known or result.tasks)))


def _panel(
    runs: Sequence[tuple[str, MetricRows]], key: str, methods: Sequence[str], label: str, name: str
) -> str:
    """One quantity of all runs on a task as SVG; empty if no run has it."""
    curves = [(method, points) for method, rows in runs if (points := _points(rows, key))]
    if not curves:
        return ""
    with plotting():
        figure = new_figure(3.0 + legend_height(len({method for method, _ in curves})), width=4.8)
        axes = figure.subplots()
        lines: dict[str, Any] = {}
        for method, points in curves:
            style = line_style(methods.index(method))
            (lines[method],) = axes.plot(*_smooth(points), linewidth=1.3, alpha=0.85, **style)
        axes.set(title=key, xlabel="step")
        if key in ("accuracy", "score"):
            axes.set_ylim(-0.02, 1.02)
        tidy(axes)
        legend(figure, lines)
        return svg(figure, name, f"Learning curves: {label}")


def _points(rows: MetricRows, key: str) -> list[tuple[float, float]]:
    """(step, value) where a quantity was measured."""
    return [
        (row["step"], row[key])
        for row in rows
        if _is_finite(row["step"]) and _is_finite(row.get(key))
    ]


def _is_finite(number: object) -> bool:
    return isinstance(number, int | float) and abs(number) < LARGEST


def _smooth(points: Sequence[tuple[float, float]]) -> tuple[Floats, Floats]:
    """A trailing moving average: the metrics of single batches are noisy."""
    steps, values = np.array(points, np.float64).T
    width = max(1, min(SMOOTHING, len(points) // 10))
    ends = np.arange(len(points), 0, -max(1, len(points) // MAX_POINTS))[::-1]
    means = [values[max(end - width, 0) : end].mean() for end in ends]
    return steps[ends - 1], np.array(means)


def save_learning_curves(run: Path) -> Path | None:
    """Plot every number in a run's metrics against the step, as a PNG in the run folder.

    Returns:
        The picture's path; `None`, without a picture, if there are no numbers yet or matplotlib
        (extra `report`) is not installed.
    """
    rows = read_metrics(run)
    names = list(dict.fromkeys(name for row in rows for name in row if name not in NOT_PLOTTED))
    if not names or importlib.util.find_spec("matplotlib") is None:
        return None
    picture = run / CURVES
    with write_atomically(picture) as file:
        _figure(rows, names).savefig(file, format="png", dpi=80)
    return picture


def _figure(rows: MetricRows, names: Sequence[str]) -> Any:
    lines = math.ceil(len(names) / COLUMNS)
    figure = new_figure(2.4 * lines, width=3.6 * COLUMNS)
    panels = figure.subplots(lines, COLUMNS, squeeze=False).flatten()
    for axes, name in zip(panels, names, strict=False):
        points = [(row["step"], row[name]) for row in rows if row.get(name) is not None]
        axes.plot(*zip(*points, strict=True), linewidth=1.0)
        axes.set_title(name.replace("_", " "), fontsize=10)
        tidy(axes)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    return figure
