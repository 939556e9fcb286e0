"""Statistics of scores: the paper's, and those of Agarwal et al. (2021), on numpy and scipy.

Scores come as arrays with one row for each repetition (a run, or a rollout) and one column for
each stratum (an environment or a task). Sources: appendix C; "Deep reinforcement learning at the
edge of the statistical precipice", NeurIPS 2021.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical.evaluation.variants import short_variant

Floats = NDArray[np.float64]
Statistic = Callable[[Floats], Floats]  # (..., n, strata) -> (...)


class Spread(NamedTuple):
    """A mean and a standard deviation."""

    mean: float
    std: float


class Interval(NamedTuple):
    """An estimate with its confidence interval."""

    value: float
    low: float
    high: float


def over_runs(scores: ArrayLike, ddof: int = 0) -> Spread:
    """The paper's figure: mean and standard deviation over runs of the run means (appendix C).

    `scores` (runs, rollouts). The appendix does not give the divisor of the standard deviation:
    runs - `ddof`.
    """
    means = _two_dimensions(scores).mean(axis=1)  # (runs,)
    return Spread(float(means.mean()), float(means.std(ddof=ddof)))


def mean(scores: ArrayLike) -> Floats:
    """The mean over repetitions and strata; `scores` (..., n, strata)."""
    means: Floats = np.asarray(scores, np.float64).mean(axis=(-2, -1))
    return means


def interquartile_mean(scores: ArrayLike) -> Floats:
    """The mean of the middle half of all scores; `scores` (..., n, strata).

    A quarter of the scores, rounded down, is left out at either end.
    """
    flat = _flat(scores)
    cut = flat.shape[-1] // 4
    middle: Floats = np.sort(flat, axis=-1)[..., cut : flat.shape[-1] - cut].mean(axis=-1)
    return middle


def optimality_gap(scores: ArrayLike, target: float = 1.0) -> Floats:
    """By how much scores fall short of `target` on average; `scores` (..., n, strata)."""
    gaps: Floats = np.maximum(target - _flat(scores), 0.0).mean(axis=-1)
    return gaps


def probability_of_improvement(first: ArrayLike, second: ArrayLike) -> Floats:
    """How probably `first` beats `second` in a stratum drawn at random; ties count half.

    `first` (..., n, strata), `second` (..., m, strata).
    """
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    difference = a[..., :, None, :] - b[..., None, :, :]  # (..., n, m, strata)
    won: Floats = ((np.sign(difference) + 1.0) / 2.0).mean(axis=(-3, -2, -1))
    return won


def bootstrap_interval(
    scores: ArrayLike,
    rng: np.random.Generator,
    statistic: Statistic = mean,
    confidence: float = 0.95,
    draws: int = 2000,
) -> Interval:
    """The percentile interval of a stratified bootstrap; `scores` (n, strata).

    Each stratum's repetitions are drawn again with replacement, independently of the others'.
    """
    table = _two_dimensions(scores)
    samples = _all_draws([table], rng, lambda drawn: statistic(drawn[0]), draws)
    return _interval(float(statistic(table)), samples, confidence)


def bootstrap_difference(
    first: ArrayLike,
    second: ArrayLike,
    rng: np.random.Generator,
    compare: Callable[[Floats, Floats], Floats] = lambda a, b: mean(a) - mean(b),
    confidence: float = 0.95,
    draws: int = 2000,
) -> Interval:
    """As `bootstrap_interval` for a comparison of two; both (n, strata), drawn independently.

    `compare` may be `probability_of_improvement`; by default it is the difference of the means.
    """
    tables = [_two_dimensions(first), _two_dimensions(second)]
    samples = _all_draws(tables, rng, lambda drawn: compare(*drawn), draws)
    return _interval(float(compare(*tables)), samples, confidence)


def generalisation_gaps(means: Mapping[str, float]) -> dict[str, float]:
    """For each test variant, Demo's mean score less the variant's; `means` by variant.

    Raises `KeyError` where there is no Demo.
    """
    short = {short_variant(variant): value for variant, value in means.items()}
    demo = short.pop("Demo")
    return {variant: demo - value for variant, value in short.items()}


def _flat(scores: ArrayLike) -> Floats:
    array = np.asarray(scores, np.float64)
    return array.reshape(*array.shape[:-2], -1)


def _two_dimensions(scores: ArrayLike) -> Floats:
    array = np.asarray(scores, np.float64)
    if array.ndim != 2 or not array.size:
        raise ValueError(
            f"scores: expected a row for each repetition and a column for each stratum, found "
            f"shape {array.shape}; a plain list of scores is one column: scores[:, None]"
        )
    return array


CHUNK = 1 << 22  # scores, or pairs of scores, drawn at a time: bounds the memory


def _all_draws(
    tables: list[Floats],
    rng: np.random.Generator,
    statistic: Callable[[list[Floats]], Floats],
    draws: int,
) -> Floats:
    per_draw = math.prod(map(len, tables)) * tables[0].shape[1]  # pairs, where two are compared
    per_chunk = max(1, CHUNK // per_draw)
    chunks = [
        statistic([_draw(table, rng, min(per_chunk, draws - start)) for table in tables])
        for start in range(0, draws, per_chunk)
    ]
    return np.concatenate(chunks)


def _draw(table: Floats, rng: np.random.Generator, draws: int) -> Floats:
    rows = rng.integers(len(table), size=(draws, *table.shape))
    return table[rows, np.arange(table.shape[1])]  # (draws, n, strata)


def _interval(value: float, samples: Floats, confidence: float) -> Interval:
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(samples, [tail, 1.0 - tail])
    return Interval(value, float(low), float(high))
