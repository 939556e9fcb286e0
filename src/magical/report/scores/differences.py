"""Our scores compared with the published ones: only with the same rule, horizon and scene."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from magical.evaluation import (
    Entry,
    by_variant,
    difference_from_published,
    published_methods,
    published_score,
)
from magical.evaluation.intervals import Interval
from magical.tasks import Task, parse_horizon

RULE = "published_code_score"


def matching_methods(entries: Iterable[Entry]) -> tuple[str, ...]:
    """The methods of the published tables that have the name of an entry's method."""
    names = {entry.method for entry in entries}
    return tuple(method for method in published_methods() if method in names)


def counterparts(entries: Iterable[Entry], published: Sequence[str]) -> dict[str, str]:
    """The published row that each method is compared with: the one of the same name.

    If no method has the name of a published row, and there is only one such row, all methods are
    compared with that one.
    """
    names = list(dict.fromkeys(entry.method for entry in entries))
    same = {name: name for name in names if name in published}
    if not same and len(published) == 1:
        return dict.fromkeys(names, published[0])
    return same


def horizon_of(task: Task, run: Entry) -> int:
    """The horizon, in control steps, that a run was evaluated with on a task."""
    return task.resolve_horizon(parse_horizon(run.horizon))


def is_comparable(task: Task, run: Entry) -> bool:
    """Whether a run was evaluated with the horizon of the published rows of a task."""
    return horizon_of(task, run) == task.resolve_horizon("published")


def differences(task: Task, runs: Sequence[Entry], method: str) -> Mapping[str, Interval]:
    """Our mean minus the published one, by short variant name, where they can be compared.

    Runs that see the state cannot: all published rows see pixels. Demo scores of nudged runs
    cannot: the published ones are for the exact scene (docs/determinism.md).
    """
    if not all(is_comparable(task, run) and not run.privileged for run in runs):
        return {}
    tables = [by_variant(run.scores).get(task.name, {}) for run in runs]
    nudged = any(run.nudge for run in runs)
    found = {}
    for variant in tables[0]:
        spread = published_score(task.name, method, variant)
        complete = all(variant in table for table in tables)
        if spread is not None and complete and not (nudged and variant == "Demo"):
            means = [np.mean([getattr(row, RULE) for row in table[variant]]) for table in tables]
            found[variant] = difference_from_published(means, spread)
    return found
