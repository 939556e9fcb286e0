"""The differences from the published scores as a heat map, a panel for each row."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magical.files import write_atomically
from magical.report.figures import new_figure, plotting
from magical.tasks.axes import SHORT_VARIANTS
from studies.published_tables.cells import LIMITS, ComparedCell, distance_text
from studies.published_tables.rows import CODE

DIGEST = "Cells"  # in the file's metadata: what the picture was made from
LIMIT = 4.0  # pooled standard deviations at which colours end
DARK = 2.5  # from there numbers are white
COLUMNS = 2
WIDTH, LINE = 4.9, 0.26  # inches: of a panel, and the height of a task in it
HEAD = 0.6  # the height of title and variants above
DPI = 100
COLOURS = 256  # of the file's palette
INK, ABSENT = "#222222", "#dddddd"


def write_picture(
    path: Path, panels: Mapping[str, Sequence[ComparedCell]], tasks: Sequence[str], digest: str
) -> None:
    """Write a PNG file.

    Args:
        path: the file.
        panels: the cells of each method, at least one; empty for one that was not run.
        tasks: the order of the panels' rows. A panel shows those it has cells of; without any,
            it shows all, grey.
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


def _figure(panels: Mapping[str, Sequence[ComparedCell]], tasks: Sequence[str]) -> Any:
    run = [{cell.task for cell in cells} or set(tasks) for cells in panels.values()]
    rows = [[task for task in tasks if task in names] for names in run]
    lines = range(0, len(rows), COLUMNS)
    tallest = [max(len(names) for names in rows[line : line + COLUMNS]) for line in lines]
    height = sum(HEAD + LINE * count for count in tallest)
    figure = new_figure(height + 0.8, WIDTH * COLUMNS)
    ratios = {"height_ratios": tallest}
    axes = figure.subplots(len(lines), COLUMNS, squeeze=False, gridspec_kw=ratios).ravel()
    for number, (place, (method, cells)) in enumerate(zip(axes, panels.items(), strict=False)):
        image = _draw(place, method, cells, rows[number])
        place.set_ylim(tallest[number // COLUMNS] - 0.5, -0.5)  # cells as high as the neighbour's
    for place in axes[len(panels) :]:
        place.set_axis_off()
    label = "our mean less the published one, in pooled standard deviations; white: no such variant"
    options = {"orientation": "horizontal", "aspect": 60, "label": label}
    figure.colorbar(image, ax=list(axes), fraction=0.4 / height, pad=0.3 / height, **options)
    return figure


def _draw(axes: Any, method: str, cells: Sequence[ComparedCell], tasks: Sequence[str]) -> Any:
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
    axes.xaxis.tick_top()
    axes.set_xticks(range(len(SHORT_VARIANTS)), SHORT_VARIANTS, fontsize=6)
    axes.set_yticks(range(len(tasks)), tasks, fontsize=8)
    axes.tick_params(length=0)
    axes.set_title(method.replace(f", {CODE}", ", published code's settings"), fontsize=10)
    for spine in axes.spines.values():
        spine.set_visible(False)
    return image
