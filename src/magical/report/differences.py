"""Our scores beside the published ones: by the published code's rule, horizon and scene only."""

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
from magical.tasks import Task

RULE = "published_code_score"


def matching_methods(entries: Iterable[Entry]) -> tuple[str, ...]:
    """The methods of the published tables whose names some entries have."""
    names = {entry.method for entry in entries}
    return tuple(method for method in published_methods() if method in names)


def counterpart(method: str, published: Sequence[str]) -> str | None:
    """The published row to hold a method against: of its name, else the only one there is."""
    if method in published:
        return method
    return published[0] if len(published) == 1 else None


def steps(task: Task, run: Entry) -> str:
    """The number of control steps that a run was evaluated with on a task."""
    known = {"appendix": task.horizon, "published": task.published_horizon}
    return str(known.get(run.horizon, run.horizon))


def obstacle(task: Task, runs: Sequence[Entry]) -> str:
    """Why runs cannot be held against published rows of a task; empty if they can."""
    expected = str(task.published_horizon)
    if any(steps(task, run) != expected for run in runs):
        return f"published with horizon {expected}"
    return ""


def differences(task: Task, runs: Sequence[Entry], method: str) -> Mapping[str, Interval]:
    """Our mean less the published one by short variant name, where they can be compared.

    Demo of nudged runs cannot: the published Demo scores are of the exact scene
    (docs/determinism.md).
    """
    if obstacle(task, runs):
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
