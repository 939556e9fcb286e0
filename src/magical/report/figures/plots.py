"""Plots as SVG for inlining in one HTML page: unique ids, text kept as text."""

import html
import io
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from magical.evaluation.intervals import Interval

# Okabe and Ito's colours, which are colour-blind safe; then the same colours with other dashes.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")
DASHES = ("-", "--", ":", "-.")
WIDTH = 6.0  # inches
STYLE: Any = {
    "font.size": 11,
    "svg.fonttype": "none",  # text stays text: searchable, and readable by screen readers
    "svg.hashsalt": "magical",  # the same figure gets the same ids
    "text.parse_math": False,  # method names are shown verbatim
}


def line_style(index: int) -> dict[str, Any]:
    """Colour and dashes of the method with this index; distinct for the first 28."""
    dashes = DASHES[index // len(COLOURS) % len(DASHES)]
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": dashes}


@contextmanager
def plotting() -> Iterator[None]:
    """Apply the settings that figures are made and saved with."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # Text stays text and is shown in the reader's fonts, so matplotlib's need not have it.
        warnings.filterwarnings("ignore", "Glyph ", UserWarning)
        yield


def new_figure(height: float, width: float = WIDTH) -> Any:
    """An empty figure of a size in inches."""
    # From the `report` extra. `Figure` without pyplot: no window system, no global state.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def svg(figure: Any, name: str, label: str) -> str:
    """A figure as an `<svg>` element; call this within `plotting`.

    Args:
        figure: a matplotlib figure.
        name: a prefix of all ids in the figure, unique on the page.
        label: what the figure shows, for screen readers.
    """
    file = io.StringIO()
    figure.savefig(file, format="svg")
    text = file.getvalue()
    text = text[text.index("<svg") :]
    # Remove the metadata and the style sheet, which would apply to the whole page.
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'\b(id=")|(url\(#)|(href="#)', lambda m: f"{m[0]}{name}-", text)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r' (width|height)="[\d.]+pt"', "", text, count=2)
    return text.replace("<svg", f'<svg role="img" aria-label="{html.escape(label)}"', 1)


def interval_plot(intervals: Mapping[str, Interval], label: str, name: str) -> str:
    """Estimates with their intervals, one below another, in the methods' colours."""
    with plotting():
        figure = new_figure(0.9 + 0.36 * len(intervals))
        axes = figure.subplots()
        for index, (value, low, high) in enumerate(intervals.values()):
            colour = line_style(index)["color"]
            if not np.isnan(low):
                axes.plot([low, high], [index, index], color=colour, linewidth=3, alpha=0.5)
            axes.plot([value], [index], "o", color=colour, markersize=6)
        axes.set_yticks(range(len(intervals)), list(intervals))
        axes.set_ylim(len(intervals) - 0.5, -0.5)
        axes.set_xlabel(label)
        tidy(axes)
        return svg(figure, name, label)


def legend(figure: Any, lines: Mapping[str, Any]) -> None:
    """Add a legend below a figure, with lines by name; no legend without lines."""
    if lines:
        # matplotlib leaves out names that begin with an underscore.
        names = [f"\u200b{name}" if name.startswith("_") else name for name in lines]
        options = {"loc": "outside lower center", "frameon": False, "fontsize": 10}
        figure.legend(lines.values(), names, ncols=min(len(names), 2), **options)


def legend_height(count: int) -> float:
    """The height, in inches, that a legend with `count` lines adds to a figure."""
    return 0.22 * -(-count // 2)


def tidy(axes: Any) -> None:
    """Add a light grid, and remove the frame at the top and on the right."""
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
