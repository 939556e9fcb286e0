"""Methods compared in more detail: gaps along each axis, every pair of methods, profiles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magical.evaluation.intervals import Interval
from magical.evaluation.statistics import performance_profile, probability_of_improvement
from magical.evaluation.variants import short_variant
from magical.report.scores.aggregate import interval_text
from magical.report.scores.methods import ComparedMethod
from magical.report.scores.tables import Cell, Row, Table
from magical.tasks import VARIANTS

THRESHOLDS = np.linspace(0.0, 1.0, 50, endpoint=False)  # no score exceeds 1
AXES = tuple(variant for variant in VARIANTS if variant != "Demo")


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of plain text with a heading, and what it says."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""


def gap_grid(methods: Sequence[ComparedMethod]) -> Grid | None:
    """Each method's generalisation gap along each axis; `None` where there is none."""
    axes = [axis for axis in AXES if methods[0].generalisation_gap(axis) is not None]
    if not axes:
        return None
    rows = [
        (method.name, *(interval_text(method.generalisation_gap(axis)) for axis in axes))
        for method in methods
    ]
    return Grid(
        "Generalisation gaps",
        ("method", *map(short_variant, axes)),
        rows,
        "Demo's mean score minus the variant's, by task, then the mean over the tasks that have "
        "the variant: the larger, the worse the method generalises along that axis. Intervals as "
        "above.",
    )


def improvement_table(methods: Sequence[ComparedMethod]) -> Table | None:
    """How probably a run of the row's method beats one of the column's; `None` for one method."""
    if len(methods) < 2:
        return None
    names = tuple(method.name for method in methods)
    rows = tuple(
        Row(
            row.name,
            {other.name: _improvement(row, other) for other in methods if other.name != row.name},
            row.unit,
        )
        for row in methods
    )
    note = (
        "How probably a run of the row's method scores more than one of the column's, averaged "
        "over environments; ties count half. 95% intervals over runs."
    )
    return Table("Probability of improvement", names, rows, note)


def profiles(methods: Sequence[ComparedMethod]) -> dict[str, list[Interval]]:
    """Each method's performance profile at `THRESHOLDS`, by name."""
    return {method.name: performance_profile(method.means, THRESHOLDS) for method in methods}


def _improvement(method: ComparedMethod, other: ComparedMethod) -> Cell:
    value, low, high = probability_of_improvement(method.means, other.means)
    return Cell(value, f"[{low:.2f}, {high:.2f}]")
