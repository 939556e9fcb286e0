"""All environments in one figure a method, with intervals (Agarwal et al., 2021)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from magical.evaluation import Entry
from magical.evaluation.statistics import (
    Floats,
    Interval,
    bootstrap_difference,
    bootstrap_interval,
    interquartile_mean,
    mean,
    optimality_gap,
    probability_of_improvement,
)


@dataclass(frozen=True, slots=True)
class Aggregate:
    """One method over all environments that the methods compared have in common."""

    method: str
    mean: Interval
    interquartile_mean: Interval
    optimality_gap: Interval
    improvement: Interval | None  # probability of being better than the first method


def aggregates(entries: Iterable[Entry]) -> tuple[list[Aggregate], str]:
    """A line for each method, and what the intervals are drawn from.

    Repetitions are runs where every method has several, otherwise rollouts; strata are the
    environments that all methods have. Scores are by the appendix's rule.
    """
    runs: dict[str, list[Entry]] = {}
    for entry in entries:
        runs.setdefault(entry.method, []).append(entry)
    env_ids = _shared_environments([run for group in runs.values() for run in group])
    if not env_ids:
        return [], "The methods have no environment in common."
    several = all(len(group) > 1 for group in runs.values())
    tables = {method: _table(group, env_ids, several) for method, group in runs.items()}
    first = next(iter(tables.values()))
    lines = [
        _aggregate(method, table, None if table is first else first)
        for method, table in tables.items()
    ]
    drawn = "runs" if several else "rollouts (which leaves out the spread between training runs)"
    noun = "environment" if len(env_ids) == 1 else "environments"
    note = f"Over {len(env_ids)} {noun}; stratified bootstrap over {drawn}, 95% intervals."
    return lines, note


def aggregate_rows(lines: Sequence[Aggregate]) -> list[tuple[str, ...]]:
    """Plain text, a row for each method."""
    return [
        (
            line.method,
            _text(line.mean),
            _text(line.interquartile_mean),
            _text(line.optimality_gap),
            _text(line.improvement) if line.improvement else "–",
        )
        for line in lines
    ]


def aggregate_header(lines: Sequence[Aggregate]) -> tuple[str, ...]:
    """The columns' names."""
    first = lines[0].method if lines else ""
    return ("method", "mean", "interquartile mean", "optimality gap", f"P(better than {first})")


def _aggregate(method: str, table: Floats, first: Floats | None) -> Aggregate:
    # Bounds should not change from call to call.
    rng = np.random.default_rng(0)
    improvement = None
    if first is not None:
        improvement = bootstrap_difference(table, first, rng, probability_of_improvement, draws=500)
    return Aggregate(
        method,
        bootstrap_interval(table, rng, mean),
        bootstrap_interval(table, rng, interquartile_mean),
        bootstrap_interval(table, rng, optimality_gap),
        improvement,
    )


def _shared_environments(entries: Sequence[Entry]) -> list[str]:
    sets = [dict.fromkeys(row.env_id for row in entry.scores) for entry in entries]
    return [env_id for env_id in (sets[0] if sets else {}) if all(env_id in s for s in sets)]


def _table(runs: Sequence[Entry], env_ids: Sequence[str], several: bool) -> Floats:
    """(runs, environments) of run means, or (rollouts, environments) of all runs' rollouts."""
    by_env = [[_scores(run, env_id) for env_id in env_ids] for run in runs]
    if several:
        return np.array([[np.mean(scores) for scores in run] for run in by_env])
    fewest = min(len(scores) for run in by_env for scores in run)
    return np.concatenate([np.array([scores[:fewest] for scores in run]).T for run in by_env])


def _scores(run: Entry, env_id: str) -> list[float]:
    return [row.score for row in run.scores if row.env_id == env_id]


def _text(interval: Interval) -> str:
    return f"{interval.value:.2f} [{interval.low:.2f}, {interval.high:.2f}]"
