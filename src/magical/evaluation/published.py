"""The appendix's Tables 5 to 8: published scores of the baselines, as data.

Each is the mean and the standard deviation over five runs of the mean of 100 rollouts. They were
computed by the published code: compare them with `published_code_score`, evaluated with
`horizon="published"` (docs/specification.md, sections 1 and 9).
"""

import csv
import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from magical.errors import UnknownNameError
from magical.evaluation.statistics import CONFIDENCE, FEWEST_RUNS, Interval, Spread, welch_interval
from magical.tasks.axes import full_variant, short_variant

PUBLISHED_RUNS = 5
RESOLUTION = 0.005  # the most by which rounding changes a published number
PublishedTable = Mapping[tuple[str, str, str], Spread]  # (task, method, short variant)


@cache
def published_table() -> PublishedTable:
    """All 660 entries: (task, method, short variant) -> mean and standard deviation."""
    text = files("magical.evaluation").joinpath("data/published-scores.csv").read_text("utf-8")
    return {
        (row["task"], row["method"], row["variant"]): Spread(float(row["mean"]), float(row["std"]))
        for row in csv.DictReader(text.splitlines())
    }


def published_methods() -> tuple[str, ...]:
    """The methods of the published tables, for instance `BC (ST)`; ST is single-task."""
    return tuple(dict.fromkeys(method for _, method, _ in published_table()))


def published_tasks() -> tuple[str, ...]:
    """The tasks of the published tables."""
    return tuple(dict.fromkeys(task for task, _, _ in published_table()))


def published_score(task: str, method: str, variant: str) -> Spread | None:
    """The published mean and standard deviation; `None` if the table has a dash.

    `variant` may be short (`Jitter`) or as in ids (`TestJitter`). Raises `UnknownNameError` for a
    task, method or variant that is not in the tables.
    """
    for name, known in ((task, published_tasks()), (method, published_methods())):
        if name not in known:
            raise UnknownNameError(
                f"{name!r} is not in the published tables; expected one of: {', '.join(known)}"
            )
    return published_table().get((task, method, short_variant(full_variant(variant))))


def difference_from_published(means: ArrayLike, published: Spread) -> Interval:
    """The mean of our runs' means (runs,) minus the published one, with Welch's t interval.

    The published tables give a standard deviation over five runs, but not its divisor; the interval
    assumes the one that makes it wider (the number of runs). There is no interval for fewer runs
    than `FEWEST_RUNS`. The means are of one environment, by the published code's rule.
    """
    ours = np.asarray(means, np.float64)
    value = float(ours.mean()) - published.mean
    if len(ours) < FEWEST_RUNS:
        return Interval(value, math.nan, math.nan)
    published_std = max(published.std, RESOLUTION)
    variances = ours.var(ddof=1) / len(ours), published_std**2 / (PUBLISHED_RUNS - 1)
    degrees = len(ours) - 1, PUBLISHED_RUNS - 1
    return welch_interval(value, variances, degrees, CONFIDENCE, (-math.inf, math.inf))
