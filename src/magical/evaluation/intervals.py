"""Confidence intervals: Student's t over strata, Wilson's score interval, square-and-add.

docs/protocol.md gives the sources of the formulas.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

CONFIDENCE = 0.95
TINY = 1e-12  # smaller variances are only rounding error
FEWEST_RUNS = 3  # for an interval over runs; two often agree by chance


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


def t_interval(
    value: float, strata: Sequence[Floats], confidence: float, bounds: tuple[float, float]
) -> Interval:
    """Student's t interval of a sum of contributions from independent strata.

    Args:
        value: the estimate.
        strata: for each stratum, the contributions of its runs, (runs,); all together they sum to
            the estimate, or differ from it by a constant.
        confidence: nominal coverage.
        bounds: the smallest and the largest possible value.

    Returns:
        The interval with Welch's degrees of freedom; its ends are NaN if a stratum has one run.
    """
    _check_confidence(confidence)
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
    """Student's t interval of a sum of independent parts, with Welch's degrees of freedom.

    Args:
        value: the estimate.
        variances: the variances of the parts, (parts,).
        degrees: of freedom, of each variance, or one number for all.
        confidence: nominal coverage.
        bounds: the smallest and the largest possible value.
    """
    from scipy.special import stdtrit  # slow to import

    _check_confidence(confidence)
    parts = np.asarray(variances, np.float64)
    total = float(parts.sum())
    welch = total**2 / (parts**2 / np.asarray(degrees)).sum() if total > 0.0 else 1.0
    half = float(stdtrit(welch, (1.0 + confidence) / 2.0)) * math.sqrt(total)
    return Interval(value, max(value - half, bounds[0]), min(value + half, bounds[1]))


def wilson_interval(value: float, count: float, confidence: float = CONFIDENCE) -> Interval:
    """Wilson's score interval: all p with count (value - p)^2 <= z^2 p (1 - p).

    Args:
        value: the mean of values from 0 to 1.
        count: the effective number of independent zeros and ones.
        confidence: nominal coverage.
    """
    _check_confidence(confidence)
    ratio = NormalDist().inv_cdf((1.0 + confidence) / 2.0) ** 2 / count
    centre = value + ratio / 2.0
    root = math.sqrt(max(centre**2 - (1.0 + ratio) * value**2, 0.0))
    low, high = (centre - root) / (1.0 + ratio), (centre + root) / (1.0 + ratio)
    # The value is always inside; rounding must not put it outside.
    return Interval(value, max(min(low, value), 0.0), min(max(high, value), 1.0))


def rollout_mean(scores: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """The mean of one policy's rollouts in one environment, with a Wilson interval.

    It does not include the spread between training runs. For scores of 0 and 1 it is Wilson's
    interval (1927). In general it is Wilson's for an effective number of zeros and ones, whose mean
    has the same variance: rollouts x p (1 - p) / variance, as in surveys (Korn and Graubard, 1998).
    If all scores are equal, that number is the number of rollouts.

    Args:
        scores: (rollouts,), each from 0 to 1.
        confidence: nominal coverage of the interval.

    Raises:
        ValueError: an empty array or one of another shape, or scores outside [0, 1].
    """
    rollouts = np.asarray(scores, np.float64)
    if rollouts.ndim != 1 or not rollouts.size:
        raise ValueError(f"scores: expected shape (rollouts,), found {rollouts.shape}")
    check_range(rollouts)
    value, variance = float(rollouts.mean()), float(rollouts.var())
    worth = value * (1.0 - value) / variance if variance > TINY else 1.0
    return wilson_interval(value, len(rollouts) * worth, confidence)


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


def _check_confidence(confidence: float) -> None:
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected more than 0 and less than 1, found {confidence:g}")


def check_range(scores: Floats) -> None:
    """Raise `ValueError` if scores are outside [0, 1]; NaN is allowed."""
    if (outside := scores[(scores < 0.0) | (scores > 1.0)]).size:
        raise ValueError(f"scores: expected values from 0 to 1, found {outside[0]:g}")
