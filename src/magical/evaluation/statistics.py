"""Statistics of scores with intervals: the paper's, and those of Agarwal et al. (2021).

`scores` (runs, environments) has a row for each training run and a column for each environment:
the run's mean score there, or NaN. The unit of intervals over runs is the run, whose scores in
several environments vary together. Runs evaluated in the same environments form a stratum; strata
are independent of each other. docs/protocol.md gives the formulas and their sources.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import groupby
from operator import attrgetter
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical.envs import EnvId, parse_env_id
from magical.evaluation.entry import RolloutScore
from magical.grouping import group_by
from magical.tasks.axes import full_variant

Floats = NDArray[np.float64]

RULES = ("score", "published_code_score")
CONFIDENCE = 0.95
FEWEST_RUNS = 3  # for an interval over runs; two often agree by chance
TINY = 1e-12  # smaller variances are only rounding error
ROUNDING = 1e-12  # means that differ by less are equal


class Spread(NamedTuple):
    """A mean and a standard deviation."""

    mean: float
    std: float


class Interval(NamedTuple):
    """An estimate with its confidence interval.

    `low` and `high` are NaN if there is no interval: one run, or several that do not differ, do not
    show the spread between runs.
    """

    value: float
    low: float
    high: float


class OverRollouts(Interval):
    """An interval over rollouts: it does not include the spread between training runs."""

    __slots__ = ()


def by_environment(
    rollouts: Iterable[RolloutScore], rule: str = "score"
) -> dict[EnvId, list[float]]:
    """The scores of a run's rollouts by environment, by one of `RULES`."""
    scores: dict[EnvId, list[float]] = {}
    for env_id, rows in groupby(rollouts, attrgetter("env_id")):  # mostly in order: a few groups
        scores.setdefault(env_id, []).extend(map(attrgetter(rule), rows))
    return scores


def run_means(
    runs: Sequence[Iterable[RolloutScore]], env_ids: Iterable[str], rule: str = "score"
) -> Floats:
    """Each run's mean score in each environment (runs, environments); NaN where it has none."""
    scores = [by_environment(run, rule) for run in runs]
    ids = [parse_env_id(env_id).without_preset for env_id in env_ids]
    return np.array([[np.mean(run.get(i, np.nan)) for i in ids] for run in scores], np.float64)


# Over the rollouts of one policy.


def rollout_mean(scores: ArrayLike) -> Interval:
    """The mean of one policy's rollouts (rollouts,) in one environment, with a Wilson interval.

    For scores of 0 and 1 it is Wilson's interval (1927): all p with n (mean - p)^2 <= z^2 p (1 - p)
    for n rollouts. In general n is the effective number of zeros and ones whose mean has the same
    variance, as in surveys (Korn and Graubard, 1998): rollouts x p (1 - p) / variance, or the
    number of rollouts if all scores are equal.
    """
    rollouts = np.asarray(scores, np.float64)
    if rollouts.ndim != 1 or not rollouts.size:
        raise ValueError(f"scores: expected shape (rollouts,), found {rollouts.shape}")
    value, variance = float(rollouts.mean()), float(rollouts.var())
    worth = value * (1.0 - value) / variance if variance > TINY else 1.0
    ratio = NormalDist().inv_cdf((1.0 + CONFIDENCE) / 2.0) ** 2 / (len(rollouts) * worth)
    centre = value + ratio / 2.0
    root = math.sqrt(max(centre**2 - (1.0 + ratio) * value**2, 0.0))
    low, high = (centre - root) / (1.0 + ratio), (centre + root) / (1.0 + ratio)
    # The value is always inside; rounding must not put it outside.
    return Interval(value, max(min(low, value), 0.0), min(max(high, value), 1.0))


def weighted_sum(intervals: Sequence[Interval], weights: ArrayLike) -> Interval:
    """A weighted sum of independent estimates by square-and-add (Newcombe, 1998).

    Weights of 1 and -1 give the difference of two, weights of 1 / n the mean of n. The lower bound
    is computed from the estimates' distances to their lower bounds where weights are positive and
    to their upper bounds where they are negative; the upper bound the other way round.
    """
    values, lows, highs = np.array(intervals).T
    factors = np.asarray(weights, np.float64)
    below = factors * np.where(factors > 0, values - lows, values - highs)
    above = factors * np.where(factors > 0, highs - values, lows - values)
    value = float(factors @ values)
    return Interval(value, value - math.hypot(*below), value + math.hypot(*above))


def over_rollouts(
    runs: Sequence[Iterable[RolloutScore]],
    env_ids: Sequence[EnvId],
    weights: ArrayLike,
    rule: str = "score",
) -> OverRollouts:
    """The weighted sum of the environments' means, with an interval over the runs' rollouts.

    It is for methods with few runs, or whose runs do not differ. `weights` (environments,) are for
    instance 1 / number of environments, or `gap_weights`. Every environment needs rollouts.
    """
    scores = [by_environment(run, rule) for run in runs]
    cells: list[Interval] = []
    factors: list[float] = []
    for env_id, weight in zip(env_ids, np.asarray(weights), strict=True):
        rollouts = [run[env_id] for run in scores if env_id in run]
        cells += map(rollout_mean, rollouts)
        factors += [weight / len(rollouts)] * len(rollouts)
    return OverRollouts(*weighted_sum(cells, factors))


# Over runs.


def over_runs(scores: ArrayLike) -> Spread:
    """The paper's figure: mean and standard deviation over runs of the run means (appendix C).

    `scores` has shape (runs, rollouts), for one environment. The appendix does not give the divisor
    of the standard deviation; here it is the number of runs.
    """
    means = np.asarray(scores, np.float64).mean(axis=1)  # (runs,)
    return Spread(float(means.mean()), float(means.std()))


def mean(scores: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """The mean over environments of the mean over runs, with a t interval over runs.

    The bounds are NaN if a stratum has one run, or if the runs do not differ. Raises `ValueError`
    for another shape, a row or a column without scores, or scores outside [0, 1].
    """
    return contrast([scores], [1.0], confidence)


def difference(first: ArrayLike, second: ArrayLike) -> Interval:
    """The mean of `first` minus that of `second`, with Welch's t interval over runs.

    Both have shape (runs, environments) and the same columns; their runs are independent.
    """
    return contrast([first, second], (1.0, -1.0))


def contrast(
    tables: Sequence[ArrayLike], weights: Sequence[float], confidence: float = CONFIDENCE
) -> Interval:
    """The weighted sum of several methods' means, with Welch's t interval over runs.

    `tables` are the scores (runs, environments) of each method, with the same columns; their runs
    are independent.
    """
    checked = list(map(_table, tables))
    columns = [table.shape[1] for table in checked]
    if len(set(columns)) > 1:
        raise ValueError(f"expected scores in the same environments, found {columns} columns")
    each = [np.full(columns[0], weight / columns[0]) for weight in weights]
    return _weighted_means(list(zip(checked, each, strict=True)), confidence)


def generalisation_gap(
    scores: ArrayLike, env_ids: Sequence[str], variant: str = "TestAll"
) -> Interval:
    """Demo's mean score minus that of a test variant for each task, averaged over tasks.

    Tasks without both variants are left out. Raises `ValueError` as `mean` does, or if no task has
    both.
    """
    table, weights = _table(scores), gap_weights(env_ids, variant)
    compared = table[:, weights != 0]
    evaluated = ~np.isnan(compared).all(axis=1)
    return _weighted_means([(compared[evaluated], weights[weights != 0])], CONFIDENCE)


def gap_weights(env_ids: Sequence[str], variant: str = "TestAll") -> Floats:
    """Weights (environments,) with which the environments' means sum to the generalisation gap.

    Raises `ValueError` if no task has both variants.
    """
    parsed = [parse_env_id(env_id) for env_id in env_ids]
    signs = {full_variant(variant): -1.0, "Demo": 1.0}
    found = group_by(parsed, attrgetter("task"))
    tasks = [task for task, ids in found.items() if signs.keys() <= {i.variant for i in ids}]
    if not tasks or len(signs) == 1:
        raise ValueError(
            f"expected Demo and another variant of the same task, here {variant}, found "
            f"{', '.join(env_ids)}"
        )
    weights = [signs.get(env_id.variant, 0.0) * (env_id.task in tasks) for env_id in parsed]
    return np.array(weights) / len(tasks)


def interquartile_mean(scores: ArrayLike) -> Interval:
    """The mean of the middle half of all scores, runs and environments pooled (rliable's IQM).

    A quarter of the scores, rounded down, is left out at each end. The t interval over runs is
    that of Tukey and McLaughlin (1963): a run's contribution is the sum of its winsorised scores.
    In one environment, where each score is a run's, its degrees of freedom are those of the scores
    that are left.
    """
    table = _table(scores)
    pooled = np.sort(table[~np.isnan(table)])
    cut = len(pooled) // 4
    middle = pooled[cut : len(pooled) - cut]
    winsorised = np.clip(table, middle[0], middle[-1])
    value, contributions = float(middle.mean()), np.nansum(winsorised, axis=1) / len(middle)
    if table.shape[1] > 1 or len(table) == 1:
        found = t_interval(value, _by_stratum(table, contributions), CONFIDENCE, (0.0, 1.0))
    else:
        variance = len(table) * contributions.var(ddof=1)
        found = welch_interval(value, [variance], len(middle) - 1.0, CONFIDENCE, (0.0, 1.0))
    return _with_width(found)


def t_interval(
    value: float, strata: Sequence[Floats], confidence: float, bounds: tuple[float, float]
) -> Interval:
    """Student's t interval, with Welch's degrees of freedom, of a sum from independent strata.

    `strata` are the contributions of each stratum's runs, (runs,), which sum to `value` or differ
    from it by a constant; `bounds` are the smallest and the largest possible value. The ends are
    NaN if a stratum has one run.
    """
    degrees = [len(stratum) - 1.0 for stratum in strata]
    if not all(degrees):
        return Interval(value, math.nan, math.nan)
    variances = [len(stratum) * stratum.var(ddof=1) for stratum in strata]
    return welch_interval(value, variances, degrees, confidence, bounds)


def welch_interval(
    value: float,
    variances: ArrayLike,
    degrees: ArrayLike,
    confidence: float,
    bounds: tuple[float, float],
) -> Interval:
    """As `t_interval`, from the variances of independent parts and their degrees of freedom."""
    from scipy.special import stdtrit  # slow to import

    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected more than 0 and less than 1, found {confidence:g}")
    parts = np.asarray(variances, np.float64)
    total = float(parts.sum())
    welch = total**2 / (parts**2 / np.asarray(degrees)).sum() if total > 0.0 else 1.0
    half = float(stdtrit(welch, (1.0 + confidence) / 2.0)) * math.sqrt(total)
    return Interval(value, max(value - half, bounds[0]), min(value + half, bounds[1]))


def _table(scores: ArrayLike) -> Floats:
    table = np.asarray(scores, np.float64)
    if table.ndim != 2 or not table.size:
        raise ValueError(
            f"scores: expected a row for each run and a column for each environment, found shape "
            f"{table.shape}; scores of one environment are one column: scores[:, None]"
        )
    missing = np.isnan(table)
    if missing.all(axis=0).any() or missing.all(axis=1).any():
        raise ValueError("scores: expected a score in each row and each column, found only NaN")
    if (outside := table[(table < 0.0) | (table > 1.0)]).size:
        raise ValueError(f"scores: expected values from 0 to 1, found {outside[0]:g}")
    return table


def _weighted_means(parts: Sequence[tuple[Floats, Floats]], confidence: float) -> Interval:
    """The sum of environments' means over runs, from independent tables with their weights.

    Of each table (runs, environments), weights (environments,).
    """
    strata: list[Floats] = []
    for table, weights in parts:
        runs = (~np.isnan(table)).sum(axis=0)  # (environments,)
        contributions = np.nansum(table * (weights / runs), axis=1)  # (runs,)
        strata += _by_stratum(table, contributions)
    factors = np.concatenate([weights for _, weights in parts])
    bounds = float(factors[factors < 0].sum()), float(factors[factors > 0].sum())
    # The order of summation decides the last bit, which rounds ties in the studies' stored tables.
    summed = strata if len(parts) > 1 else [contributions]
    value = float(sum(part.sum() for part in summed))
    return _with_width(t_interval(value, strata, confidence, bounds))


def _with_width(interval: Interval) -> Interval:
    """The interval; without bounds if it has no width, since equal runs do not show a spread."""
    has_width = interval.high - interval.low > ROUNDING
    return interval if has_width else Interval(interval.value, np.nan, np.nan)


def _by_stratum(table: Floats, contributions: Floats) -> list[Floats]:
    """The contributions of each stratum's runs: of the rows with NaN in the same columns."""
    strata = group_by(range(len(table)), lambda run: np.isnan(table[run]).tobytes())
    return [contributions[runs] for runs in strata.values()]
