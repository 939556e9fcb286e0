"""Plain-text tables: methods over all environments and along each axis.

Statistics follow Agarwal et al. (2021); intervals are those of `magical.evaluation.statistics`.
"""

import math
from collections.abc import Sequence

from magical.evaluation import Entry
from magical.evaluation.intervals import Interval, OverRollouts
from magical.messages import decimals
from magical.report.found.statements import MARKS
from magical.report.scores.methods import ComparedMethod
from magical.report.scores.tables import RUNS_APART, TextTable
from magical.tasks import VARIANTS
from magical.tasks.axes import short_variant

AXES = tuple(variant for variant in VARIANTS if variant != "Demo")
SHOWN = 6  # environments named in a note
NOTE = (
    "95% intervals over training runs; with fewer than three runs of an environment, or where runs "
    "do not differ, they are over rollouts, and do not include the spread between training runs. "
    "The interquartile mean has no interval then."
) + MARKS


def interval_text(interval: Interval | None, unit: str = "rollouts") -> str:
    """An interval as text; without brackets if there is only the estimate.

    `unit` is what the row's intervals are said to be over; an interval over rollouts in a row over
    runs says so.
    """
    if interval is None:
        return "–"
    value, low, high = map(decimals, interval)
    return value if math.isnan(interval.low) else f"{value} [{low}, {high}]{over(interval, unit)}"


def over(interval: Interval, unit: str) -> str:
    """` over rollouts` for such an interval in a row over runs; otherwise empty."""
    differs = isinstance(interval, OverRollouts) and not unit.startswith("rollouts")
    return " over rollouts" if differs else ""


def mean_text(method: ComparedMethod) -> str:
    """The mean with its interval, and the runs' means where a few of them differ much."""
    return interval_text(method.mean(), method.unit) + method.means_apart()


def gap_text(method: ComparedMethod, variant: str = "TestAll") -> str:
    """The generalisation gap, as `mean_text`."""
    gap = method.generalisation_gap(variant)
    return "–" if gap is None else interval_text(gap, method.unit) + method.gaps_apart(variant)


def aggregate_table(methods: Sequence[ComparedMethod], entries: Sequence[Entry]) -> TextTable:
    """A row for each method, over all environments that the methods have in common.

    Args:
        methods: the entries' methods, at least one. The others are compared with the first.
        entries: all entries; environments left out of the comparison are named in the note.
    """
    first = methods[0]
    header = ["method", "intervals over", "mean", "interquartile mean"]
    header += ["generalisation gap"]
    if len(methods) > 1:
        header.append(f"difference from {first.name}")
    rows = []
    for method in methods:
        row = [method.name, method.unit, mean_text(method)]
        row += [interval_text(method.interquartile_mean()), gap_text(method)]
        if method is not first:
            row.append(interval_text(method.difference(first), method.unit))
        rows.append((*row, *["–"] * (len(header) - len(row))))
    count = len(first.env_ids)
    note = f"Over {count} environment{'s' if count != 1 else ''}.{_left_out(first, entries)} {NOTE}"
    if any(method.means_apart() for method in methods):
        note += RUNS_APART
    return TextTable("All environments", tuple(header), rows, note)


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
    rows = [(method.name, *(gap_text(method, axis) for axis in axes)) for method in methods]
    note = (
        "The mean score on Demo minus that on the variant, by task, averaged over the tasks that "
        "have the variant: the larger, the worse the method generalises along that axis. Intervals "
        "as above."
    )
    return TextTable("Generalisation gaps", ("method", *map(short_variant, axes)), rows, note)
