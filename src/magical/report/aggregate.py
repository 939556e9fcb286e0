"""All environments in one row for each method, with intervals (Agarwal et al., 2021)."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from magical.envs import EnvId
from magical.evaluation import Entry
from magical.evaluation.intervals import Floats, Interval, weighted_sum
from magical.evaluation.statistics import (
    by_environment,
    difference,
    gap_weights,
    generalisation_gap,
    interquartile_mean,
    mean,
    optimality_gap,
    over_rollouts,
    probability_of_improvement,
    run_means,
)

NOTE = (
    "95% intervals over training runs. Where a method has one run, the intervals of its mean, its "
    "generalisation gap and its difference are over rollouts, which does not include the spread "
    "between training runs; its interquartile mean has none."
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


@dataclass(frozen=True, slots=True)
class _Method:
    """One method's runs on the environments that are compared."""

    name: str
    runs: Sequence[Entry]
    env_ids: Sequence[EnvId]
    means: Floats  # (runs, environments); NaN where a run was not evaluated

    @property
    def several(self) -> bool:
        """Whether there are enough runs for intervals over runs."""
        return not math.isnan(mean(self.means).low)

    @property
    def unit(self) -> str:
        """What intervals are over, in words."""
        counts = (~np.isnan(self.means)).sum(axis=0)
        if not self.several:
            return "rollouts of 1 run" if counts.max() == 1 else "rollouts"
        fewest, most = counts.min(), counts.max()
        return f"{fewest} runs" if fewest == most else f"{fewest} to {most} runs"

    def mean(self) -> Interval:
        """Over runs, or over rollouts where there is one run."""
        if self.several:
            return mean(self.means)
        return self._over_rollouts(np.full(len(self.env_ids), 1 / len(self.env_ids)))

    def generalisation_gap(self) -> Interval | None:
        """As `mean`; `None` where no task has both variants."""
        try:
            weights = gap_weights(self.env_ids)
        except ValueError:
            return None
        if self.several:
            return generalisation_gap(self.means, self.env_ids)
        return self._over_rollouts(weights)

    def _over_rollouts(self, weights: Floats) -> Interval:
        return over_rollouts([run.scores for run in self.runs], self.env_ids, weights)


def aggregates(entries: Iterable[Entry]) -> tuple[list[Aggregate], str]:
    """A row for each method, and a note on how to read them.

    Entries with the same method are its runs, each on all of its tasks or on some. The environments
    are those that all methods have; a method has an environment if all its runs on that task do.
    Scores are by the appendix's rule.
    """
    groups: dict[str, list[Entry]] = {}
    for entry in entries:
        groups.setdefault(entry.row, []).append(entry)
    env_ids = _shared_environments(list(groups.values()))
    if not env_ids:
        return [], "The methods have no environment in common."
    first, *others = (_method(name, group, env_ids) for name, group in groups.items())
    rows = [_aggregate(first), *(_aggregate(other, first) for other in others)]
    noun = "environment" if len(env_ids) == 1 else "environments"
    return rows, f"Over {len(env_ids)} {noun}. {NOTE}"


def aggregate_rows(rows: Sequence[Aggregate]) -> list[tuple[str, ...]]:
    """Plain text, a row for each method."""
    fields = _columns(rows).values()
    return [(row.method, row.unit, *(_text(getattr(row, f)) for f in fields)) for row in rows]


def aggregate_header(rows: Sequence[Aggregate]) -> tuple[str, ...]:
    """The columns' names."""
    return ("method", "intervals over", *_columns(rows))


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


def _method(name: str, group: Sequence[Entry], env_ids: Sequence[EnvId]) -> _Method:
    runs = [entry for entry in group if any(row.env_id in env_ids for row in entry.scores)]
    return _Method(name, runs, env_ids, run_means([run.scores for run in runs], env_ids))


def _aggregate(method: _Method, first: _Method | None = None) -> Aggregate:
    return Aggregate(
        method.name,
        method.unit,
        method.mean(),
        interquartile_mean(method.means),
        optimality_gap(method.means),
        method.generalisation_gap(),
        _difference(method, first) if first else None,
        probability_of_improvement(method.means, first.means) if first else None,
    )


def _difference(method: _Method, first: _Method) -> Interval:
    if method.several and first.several:
        return difference(method.means, first.means)
    return weighted_sum([method.mean(), first.mean()], [1.0, -1.0])


def _shared_environments(methods: Sequence[Sequence[Entry]]) -> list[EnvId]:
    found = [_environments(runs) for runs in methods]
    return [env_id for env_id in (found[0] if found else []) if all(env_id in ids for ids in found)]


def _environments(runs: Sequence[Entry]) -> list[EnvId]:
    """The environments that all of a method's runs on their task have, in the order they come."""
    counts = Counter(env_id for run in runs for env_id in by_environment(run.scores))
    tasks = Counter(
        task for run in runs for task in {env_id.task for env_id in by_environment(run.scores)}
    )
    return [env_id for env_id in counts if counts[env_id] == tasks[env_id.task]]


def _text(interval: Interval | None) -> str:
    if interval is None:
        return "–"
    if math.isnan(interval.low):
        return f"{interval.value:.2f}"
    return f"{interval.value:.2f} [{interval.low:.2f}, {interval.high:.2f}]"
