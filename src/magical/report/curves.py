"""Learning curves from the metrics of runs."""

import importlib.util
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from warnings import catch_warnings, filterwarnings

from magical.files import write_atomically
from magical.runs.folder import CURVES
from magical.runs.metrics import read_metrics

PANELS = ("loss", "accuracy", "score")  # of `learning_curves`, where the metrics have them
SMOOTHING = 50  # rows of metrics that a curve is averaged over, at most a tenth of all
LONGEST = 30  # characters of a name in the legend
NOT_PLOTTED = ("step", "environment_steps", "warning")
COLUMNS = 4  # of `save_learning_curves`

Rows = Sequence[Mapping[str, Any]]


def learning_curves(runs: Mapping[str, Path]) -> str:
    """The curves of all runs that have metrics, one panel for each quantity, as SVG.

    `runs` are folders by name. Empty where none has metrics.
    """
    found = {name: rows for name, folder in runs.items() if (rows := read_metrics(folder))}
    panels = [key for key in PANELS if any(key in row for rows in found.values() for row in rows)]
    return _svg(found, panels) if panels else ""


def _svg(runs: Mapping[str, Rows], panels: Sequence[str]) -> str:
    # From the report extra. Figure alone: no window system, no global state.
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * len(panels), 3.2), layout="constrained")
    for axes, key in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        lines = []
        for rows in runs.values():
            points = [(row["step"], row[key]) for row in rows if row.get(key) is not None]
            lines += axes.plot(*_smooth(points), linewidth=1.4)
        axes.set_title(key, fontsize=11)
        axes.set_xlabel("step")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        if key == "accuracy":
            axes.set_ylim(0, 1)
    file = io.StringIO()
    # A name may be any path: it is neither mathematics nor limited to the characters of a font.
    with rc_context({"svg.fonttype": "none", "text.parse_math": False}), catch_warnings():
        filterwarnings("ignore", "Glyph")
        axes.legend(lines, list(map(_shorten, runs)), frameon=False, fontsize=9)
        figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    return text[text.index("<svg") :]


def _shorten(name: str) -> str:
    """The end of a long name, where folders differ; a legend as wide as the panel has no room."""
    return name if len(name) <= LONGEST else f"…{name[1 - LONGEST :]}"


def _smooth(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """Averages over neighbouring points: the metrics of single batches are noisy."""
    width = max(1, min(SMOOTHING, len(points) // 10))
    groups = [points[i : i + width] for i in range(0, len(points) - width + 1, width)]
    xs = [sum(x for x, _ in group) / width for group in groups]
    return xs, [sum(y for _, y in group) / width for group in groups]


def save_learning_curves(run: Path) -> Path | None:
    """Plot every number of a run's metrics over the steps, as a PNG in the run folder.

    Returns:
        The picture's path; `None`, without a picture, if there are no metrics yet or matplotlib
        (extra `report`) is not installed.
    """
    rows = read_metrics(run)
    if not rows or importlib.util.find_spec("matplotlib") is None:
        return None
    names = list(dict.fromkeys(name for row in rows for name in row if name not in NOT_PLOTTED))
    picture = run / CURVES
    with write_atomically(picture) as file:
        _figure(rows, names).savefig(file, format="png", dpi=80)
    return picture


def _figure(rows: Rows, names: Sequence[str]) -> Any:
    # Figure alone: no window system, no global state.
    from matplotlib.figure import Figure

    lines = math.ceil(len(names) / COLUMNS)
    figure = Figure(figsize=(3.6 * COLUMNS, 2.4 * lines), layout="constrained")
    panels = figure.subplots(lines, COLUMNS, squeeze=False).flatten()
    for axes, name in zip(panels, names, strict=False):
        points = [(row["step"], row[name]) for row in rows if row.get(name) is not None]
        axes.plot(*zip(*points, strict=True), linewidth=1.0)
        axes.set_title(name.replace("_", " "), fontsize=10)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    return figure
