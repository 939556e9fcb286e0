"""A run's learning curves as a picture in its folder."""

import importlib.util
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from magical.files import write_atomically

PICTURE = "learning-curves.png"
HIDDEN = ("step", "environment_steps", "warning")
COLUMNS = 4


def draw_curves(metrics: Path) -> Path | None:
    """Draw every number of a `metrics.jsonl` over the steps, beside it.

    Returns the picture's path; `None`, and no picture, without matplotlib (extra `report`) or
    without reports.
    """
    rows = [json.loads(line) for line in metrics.read_text(encoding="utf-8").splitlines()]
    if not rows or importlib.util.find_spec("matplotlib") is None:
        return None
    names = list(dict.fromkeys(name for row in rows for name in row if name not in HIDDEN))
    picture = metrics.with_name(PICTURE)
    with write_atomically(picture) as file:
        _figure(rows, names).savefig(file, format="png", dpi=80)
    return picture


def _figure(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> Any:
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
