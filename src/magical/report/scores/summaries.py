"""Plain-text tables: methods over all environments, along each axis, and pair by pair.

Statistics follow Agarwal et al. (2021); intervals are those of `magical.evaluation.statistics`.
"""

import math
from collections.abc import Sequence

import numpy as np

from magical.evaluation import Entry
from magical.evaluation.intervals import Interval
from magical.evaluation.statistics import (
    interquartile_mean,
    optimality_gap,
    performance_profile,
    probability_of_improvement,
)
from magical.report.found.statements import MARKS
from magical.report.scores.methods import ComparedMethod
from magical.report.scores.tables import Cell, Row, ScoreTable, TextTable
from magical.tasks import VARIANTS
from magical.tasks.axes import short_variant

THRESHOLDS = np.linspace(0.0, 1.0, 50, endpoint=False)  # no score exceeds 1
AXES = tuple(variant for variant in VARIANTS if variant != "Demo")
SHOWN = 6  # environments named in a note
NOTE = (
    "95% intervals over training runs; those over the rollouts of a single run do not include the "
    "spread between training runs. Interquartile mean and optimality gap have no interval for a "
    "single run. If some environments have several runs and others only one, there is no interval."
) + MARKS


def interval_text(interval: Interval | None) -> str:
    """An interval as text; without brackets if there is only the estimate."""
    if interval is None:
        return "–"
    if math.isnan(interval.low):
        return f"{interval.value:.2f}"
    return f"{interval.value:.2f} [{interval.low:.2f}, {interval.high:.2f}]"


def aggregate_table(methods: Sequence[ComparedMethod], entries: Sequence[Entry]) -> TextTable:
    """A row for each method, over all environments that the methods have in common.

    Args:
        methods: the entries' methods, at least one. The others are compared with the first.
        entries: all entries; environments left out of the comparison are named in the note.
    """
    first = methods[0]
    header = ["method", "intervals over", "mean", "interquartile mean", "optimality gap"]
    header += ["generalisation gap"]
    if len(methods) > 1:
        header += [f"difference from {first.name}", f"P(better than {first.name})"]
    rows = []
    for method in methods:
        found: list[Interval | None] = [method.mean(), interquartile_mean(method.means)]
        found += [optimality_gap(method.means), method.generalisation_gap()]
        if method is not first:
            better = probability_of_improvement(method.means, first.means)
            found += [method.difference(first), better]
        found += [None] * (len(header) - 2 - len(found))
        rows.append((method.name, method.unit, *map(interval_text, found)))
    count = len(first.env_ids)
    over = f"Over {count} environment{'s' if count != 1 else ''}."
    return TextTable(
        "All environments", tuple(header), rows, f"{over}{_left_out(first, entries)} {NOTE}"
    )


def _left_out(method: ComparedMethod, entries: Sequence[Entry]) -> str:
    """A sentence that names the environments of the entries that are not compared."""
    env_ids = dict.fromkeys(row.env_id for entry in entries for row in entry.scores)
    names = [f"{i.task} {short_variant(i.variant)}" for i in env_ids if i not in method.env_ids]
    if not names:
        return ""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (
        f" Left out because not all runs and methods have them: {', '.join(names[:SHOWN])}{more}."
    )


def gap_table(methods: Sequence[ComparedMethod]) -> TextTable | None:
    """Each method's generalisation gap along each axis; `None` if there are no gaps."""
    axes = [axis for axis in AXES if methods[0].generalisation_gap(axis) is not None]
    if not axes:
        return None
    rows = [
        (method.name, *(interval_text(method.generalisation_gap(axis)) for axis in axes))
        for method in methods
    ]
    note = (
        "The mean score on Demo minus that on the variant, by task, averaged over the tasks that "
        "have the variant: the larger, the worse the method generalises along that axis. Intervals "
        "as above."
    )
    return TextTable("Generalisation gaps", ("method", *map(short_variant, axes)), rows, note)


def improvement_table(methods: Sequence[ComparedMethod]) -> ScoreTable | None:
    """The probability that the row's method beats the column's; `None` for a single method."""
    if len(methods) < 2:
        return None
    names = tuple(method.name for method in methods)
    rows = tuple(
        Row(row.name, {o.name: _improvement(row, o) for o in methods if o is not row}, row.unit)
        for row in methods
    )
    note = (
        "The probability that a run of the row's method scores higher than a run of the column's, "
        "averaged over environments; ties count as half. The 95% intervals over runs are wide "
        "(their coverage is 99 to 100%): with five runs they exclude 0.5 only if one method wins "
        "at least 94% of the pairs of runs. To decide which method is better, look at the "
        "difference of the means."
    )
    return ScoreTable("Probability of improvement", names, rows, note)


def _improvement(method: ComparedMethod, other: ComparedMethod) -> Cell:
    value, low, high = probability_of_improvement(method.means, other.means)
    return Cell(value, f"[{low:.2f}, {high:.2f}]")


def profiles(methods: Sequence[ComparedMethod]) -> dict[str, list[Interval]]:
    """Each method's performance profile at `THRESHOLDS`, by name."""
    return {method.name: performance_profile(method.means, THRESHOLDS) for method in methods}
