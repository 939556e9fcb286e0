"""Our runs and the published numbers on one scale, as far as the published tables allow."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from magical.evaluation.published import PUBLISHED_RUNS, RESOLUTION, published_table
from magical.evaluation.statistics import CONFIDENCE, Interval, Spread, welch_interval
from magical.tasks.axes import full_variant, short_variant

MULTI_TASK = "(MT"  # in the names of methods whose runs learn all tasks


def pooled_std(means: ArrayLike, published: Spread) -> float:
    """The standard deviation of run means, pooled over our runs and the published ones.

    The root of ((n - 1) s^2 + 4 p^2) / (n + 3), with n runs of sample standard deviation s and the
    published one p of five runs, taken as it is: if its divisor was 5, this is too small by up to a
    tenth, which makes differences in its units larger. At least the tables' resolution.

    Args:
        means: (runs,), each run's mean score in one environment.
        published: the mean and standard deviation of the tables.
    """
    ours = np.asarray(means, np.float64)
    squares = ((ours - ours.mean()) ** 2).sum() + (PUBLISHED_RUNS - 1) * published.std**2
    return max(math.sqrt(squares / (len(ours) + PUBLISHED_RUNS - 2)), RESOLUTION)


def published_contrast(
    weights: Mapping[str, float],
    cells: Sequence[tuple[str, str]],
    confidence: float = CONFIDENCE,
) -> Interval:
    """`magical.evaluation.statistics.contrast` of published rows, as far as the tables allow.

    They do not say how a run's scores in several variants vary together. The interval assumes that
    they vary together completely, within a task, and for multi-task methods over all tasks, which
    makes it wide; for the standard deviations' divisor see `difference_from_published`. Each is at
    least the tables' resolution.

    Args:
        weights: of each method's mean over the cells.
        cells: tasks and variants, of which the tables have all.
        confidence: nominal coverage of the interval.
    """
    table = published_table()
    value = 0.0
    deviations: list[float] = []  # of the independent parts: by method, and by task
    for method, weight in weights.items():
        parts: dict[str, float] = {}
        for task, variant in cells:
            mean, std = table[task, method, short_variant(full_variant(variant))]
            value += weight * mean / len(cells)
            key = "" if MULTI_TASK in method else task
            parts[key] = parts.get(key, 0.0) + abs(weight) * max(std, RESOLUTION) / len(cells)
        deviations += parts.values()
    variances = np.array(deviations) ** 2 / (PUBLISHED_RUNS - 1)
    bounds = sum(min(w, 0.0) for w in weights.values()), sum(max(w, 0.0) for w in weights.values())
    return welch_interval(value, variances, PUBLISHED_RUNS - 1, confidence, bounds)
