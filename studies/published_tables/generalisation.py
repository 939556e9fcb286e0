"""What methods lose between Demo and TestAll: means over the published tasks."""

import math
from collections.abc import Iterable
from statistics import fmean
from typing import NamedTuple

from magical.envs import EnvId
from magical.evaluation import published_table, published_tasks
from magical.evaluation.statistics import Interval, generalisation_gap, mean
from magical.report.table import Statements
from magical.tasks.axes import short_variant
from studies.published_tables.rows import MethodRuns

VARIANTS = ("Demo", "TestAll")
PUBLISHED = ("BC (ST)", "GAIL (ST)")  # of the published tables, for comparison


class Drop(NamedTuple):
    """A method's means, by the published code's rule; intervals are over runs.

    Attributes:
        method: the method's name.
        track: `P`, `R` or `X`, or empty.
        statements: whose demonstrations, and how often test variants were evaluated before.
        demo: mean over tasks.
        test_all: mean over tasks.
        gap: their difference.
    """

    method: str
    track: str
    statements: Statements
    demo: Interval
    test_all: Interval
    gap: Interval


def find_drops(rows: Iterable[MethodRuns]) -> list[Drop]:
    """The published methods, then the rows that have Demo and TestAll of all published tasks."""
    pairs = [(EnvId(task, VARIANTS[0]), EnvId(task, VARIANTS[1])) for task in published_tasks()]
    env_ids = [env_id for pair in pairs for env_id in pair]
    ours = [_drop(row, env_ids) for row in rows if set(env_ids) <= set(row.env_ids)]
    return [*map(_published, PUBLISHED), *ours]


def _drop(row: MethodRuns, env_ids: list[EnvId]) -> Drop:
    demo, test_all = ([i for i in env_ids if i.variant == variant] for variant in VARIANTS)
    return Drop(
        row.method,
        row.track,
        row.statements,
        mean(row.on(demo)),
        mean(row.on(test_all)),
        generalisation_gap(row.on(env_ids), env_ids),
    )


def _published(method: str) -> Drop:
    """From the published means, which come without the runs' scores."""
    table = published_table()
    demo, test_all = (
        fmean(table[task, method, short_variant(variant)].mean for task in published_tasks())
        for variant in VARIANTS
    )
    means = (Interval(value, math.nan, math.nan) for value in (demo, test_all, demo - test_all))
    track = "P" if method.startswith("BC") else ""
    statements = Statements("10 of each task (humans)")
    return Drop(f"{method}, published", track, statements, *means)
