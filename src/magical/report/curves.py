"""Learning curves from the metrics that training writes, as one picture."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from magical.errors import ScoresError

METRICS_FILE = "metrics.jsonl"
PANELS = ("loss", "accuracy", "score")  # drawn where the metrics have them
SMOOTHING = 50  # reports over which a curve is averaged, at most a tenth of all

Rows = Sequence[Mapping[str, Any]]


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """The lines of a metrics file; a last one that was cut by a crash is left out.

    Raises `ScoresError` naming a line that is no report.
    """
    rows = []
    for number, line in enumerate(path.read_text("utf-8").split("\n")[:-1], 1):
        try:
            row = json.loads(line)
            row["step"]
        except (ValueError, TypeError, KeyError) as error:
            raise ScoresError(
                f"{path}, line {number}: expected a JSON object with a step, found {line:.60}"
            ) from error
        rows.append(row)
    return rows


def learning_curves(runs: Mapping[str, Path]) -> str:
    """The curves of all runs that have metrics, one panel for each quantity, as SVG.

    `runs` are folders by name. Empty where none has metrics.
    """
    found = {
        name: read_metrics(folder / METRICS_FILE)
        for name, folder in runs.items()
        if (folder / METRICS_FILE).is_file()
    }
    panels = [key for key in PANELS if any(key in row for rows in found.values() for row in rows)]
    return _draw(found, panels) if panels else ""


def _draw(runs: Mapping[str, Rows], panels: Sequence[str]) -> str:
    # From the report extra. Figure alone: no window system, no global state.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * len(panels), 3.2), layout="constrained")
    for axes, key in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for name, rows in runs.items():
            points = [(row["step"], row[key]) for row in rows if row.get(key) is not None]
            axes.plot(*_smooth(points), label=name, linewidth=1.4)
        axes.set_title(key, fontsize=11)
        axes.set_xlabel("step")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        if key == "accuracy":
            axes.set_ylim(0, 1)
    axes.legend(frameon=False, fontsize=9)
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    return text[text.index("<svg") :]


def _smooth(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """Averages over a few neighbours each: single batches are noisy."""
    width = max(1, min(SMOOTHING, len(points) // 10))
    groups = [points[i : i + width] for i in range(0, len(points) - width + 1, width)]
    xs = [sum(x for x, _ in group) / width for group in groups]
    return xs, [sum(y for _, y in group) / width for group in groups]
