"""All environments in one row for each method, with intervals (Agarwal et al., 2021)."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from magical.envs import EnvId
from magical.evaluation import Entry
from magical.evaluation.intervals import Interval
from magical.evaluation.statistics import (
    interquartile_mean,
    optimality_gap,
    probability_of_improvement,
)
from magical.evaluation.variants import short_variant
from magical.report.scores.methods import ComparedMethod, compared_methods, left_out

SHOWN = 6  # names in a note
NOTE = (
    "95% intervals over training runs. Where a method has one run, the intervals of its mean, its "
    "generalisation gap and its difference are over rollouts, which does not include the spread "
    "between training runs; its interquartile mean has none. Where some environments have several "
    "runs and others one, there is no interval."
)


@dataclass(frozen=True, slots=True)
class Aggregate:
    """One method over all environments that the methods compared have in common."""

    method: str
    unit: str  # what the intervals are over
    mean: Interval
    interquartile_mean: Interval
    optimality_gap: Interval
    generalisation_gap: Interval | None  # where some task has both Demo and TestAll
    difference: Interval | None = None  # of the mean from the first method's
    improvement: Interval | None = None  # probability of being better than the first method


def aggregates(entries: Iterable[Entry]) -> tuple[list[Aggregate], str]:
    """A row for each method, and a note on how to read them.

    Entries with the same method are its runs, each on all of its tasks or on some. The environments
    are those that all methods have; a method has an environment if all its runs on that task do.
    Scores are by the appendix's rule.
    """
    entries = list(entries)
    methods = compared_methods(entries)
    if not methods:
        return [], "The methods have no environment in common."
    first, *others = methods
    rows = [_aggregate(first), *(_aggregate(other, first) for other in others)]
    count = len(first.env_ids)
    others_note = _left_out_note(left_out(entries, first.env_ids))
    noun = "environment" if count == 1 else "environments"
    return rows, f"Over {count} {noun}.{others_note} {NOTE}"


def aggregate_rows(rows: Sequence[Aggregate]) -> list[tuple[str, ...]]:
    """Plain text, a row for each method."""
    fields = _columns(rows).values()
    return [
        (row.method, row.unit, *(interval_text(getattr(row, f)) for f in fields)) for row in rows
    ]


def aggregate_header(rows: Sequence[Aggregate]) -> tuple[str, ...]:
    """The columns' names."""
    return ("method", "intervals over", *_columns(rows))


def _left_out_note(env_ids: Sequence[EnvId]) -> str:
    names = [f"{env_id.task} {short_variant(env_id.variant)}" for env_id in env_ids]
    if not names:
        return ""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f" Left out, since not all runs and methods have them: {', '.join(names[:SHOWN])}{more}."


def _columns(rows: Sequence[Aggregate]) -> dict[str, str]:
    """Fields of `Aggregate` by the names of their columns."""
    columns = {
        "mean": "mean",
        "interquartile mean": "interquartile_mean",
        "optimality gap": "optimality_gap",
        "generalisation gap": "generalisation_gap",
    }
    if len(rows) > 1:
        first = rows[0].method
        columns[f"difference from {first}"] = "difference"
        columns[f"P(better than {first})"] = "improvement"
    return columns


def _aggregate(method: ComparedMethod, first: ComparedMethod | None = None) -> Aggregate:
    return Aggregate(
        method.name,
        method.unit,
        method.mean(),
        interquartile_mean(method.means),
        optimality_gap(method.means),
        method.generalisation_gap(),
        method.difference(first) if first else None,
        probability_of_improvement(method.means, first.means) if first else None,
    )


def interval_text(interval: Interval | None) -> str:
    """An interval as text; without brackets where there is only the estimate."""
    if interval is None:
        return "–"
    if math.isnan(interval.low):
        return f"{interval.value:.2f}"
    return f"{interval.value:.2f} [{interval.low:.2f}, {interval.high:.2f}]"
