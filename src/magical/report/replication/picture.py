"""The differences from the published scores as a heat map, a panel for each row."""

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magical.evaluation.variants import SHORT_VARIANTS
from magical.files import write_atomically
from magical.report.plots import new_figure, plotting
from magical.report.replication.cells import LIMITS, Cell, distance_text

DIGEST = "Cells"  # in the file's metadata: what the picture was made from
LIMIT = 4.0  # pooled standard deviations at which colours end
DARK = 2.5  # from there numbers are white
COLUMNS = 2
PANEL = (4.9, 2.7)  # inches
DPI = 100
COLOURS = 256  # of the file's palette
INK, ABSENT = "#222222", "#dddddd"


def write_picture(
    path: Path, panels: Mapping[str, Sequence[Cell]], tasks: Sequence[str], digest: str
) -> None:
    """Write a PNG file.

    Args:
        path: the file.
        panels: the cells of each method, at least one; empty for one that was not run.
        tasks: the panels' rows; those without cells are grey, as not run.
        digest: of all that is shown, kept in the file.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    drawn = io.BytesIO()
    with plotting():
        _figure(panels, tasks).savefig(drawn, format="png", dpi=DPI)
    info = PngInfo()
    info.add_text(DIGEST, digest)
    with Image.open(drawn) as image, write_atomically(path) as file:
        reduced = image.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
        reduced.save(file, format="png", optimize=True, pnginfo=info)


def digest_of(path: Path) -> str:
    """What a picture was made from; empty for none."""
    from PIL import Image

    if not path.is_file():
        return ""
    with Image.open(path) as image:
        return str(image.info.get(DIGEST, ""))


def _figure(panels: Mapping[str, Sequence[Cell]], tasks: Sequence[str]) -> Any:
    lines = math.ceil(len(panels) / COLUMNS)
    figure = new_figure(PANEL[1] * lines + 0.8, PANEL[0] * COLUMNS)
    axes = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for place, (method, cells) in zip(axes, panels.items(), strict=False):
        image = _draw(place, method, cells, tasks)
    for place in axes[len(panels) :]:
        place.set_axis_off()
    label = "our mean less the published one, in pooled standard deviations; grey: not run"
    options = {"orientation": "horizontal", "aspect": 60, "label": label}
    figure.colorbar(image, ax=list(axes), fraction=0.25 / lines, **options)
    return figure


def _draw(axes: Any, method: str, cells: Sequence[Cell], tasks: Sequence[str]) -> Any:
    """One method's heat map; a number in each cell, so that nothing is in colours alone."""
    values = np.full((len(tasks), len(SHORT_VARIANTS)), np.nan)
    for cell in cells:
        values[tasks.index(cell.task), SHORT_VARIANTS.index(cell.variant)] = cell.distance
    image = axes.imshow(values, cmap="PuOr_r", vmin=-LIMIT, vmax=LIMIT, aspect="auto")
    for row in np.flatnonzero(np.isnan(values).all(axis=1)):
        axes.axhspan(row - 0.45, row + 0.45, color=ABSENT, linewidth=0)
    for row, column in np.argwhere(~np.isnan(values)):
        value = values[row, column]
        axes.text(
            column,
            row,
            distance_text(value),
            ha="center",
            va="center",
            fontsize=8,
            color="white" if abs(value) > DARK else INK,
            weight="bold" if abs(value) > LIMITS[-1] else "normal",
        )
    axes.set_xticks(range(len(SHORT_VARIANTS)), SHORT_VARIANTS, fontsize=6)
    axes.set_yticks(range(len(tasks)), tasks, fontsize=8)
    axes.tick_params(length=0)
    axes.set_title(method, fontsize=10)
    for spine in axes.spines.values():
        spine.set_visible(False)
    return image
