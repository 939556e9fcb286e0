"""Which entries can be held against the published tables, and each method's published row."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magical.envs import EnvId
from magical.evaluation import environments, published_methods
from magical.evaluation.statistics import Floats, by_environment, run_means
from magical.report.found import Found, Result, same_run
from magical.report.leaderboard import Rejected, incompleteness, mismatch
from magical.report.table import (
    PUBLISHED_RULE,
    Statements,
    gather_statements,
    is_comparable,
    marks,
)
from magical.runs import track_of
from magical.tasks import get_task

UNSTATED = Statements()
CODE = "settings of the published code, network narrow"  # in the names of methods


@dataclass(frozen=True, slots=True)
class MethodRuns:
    """One method's runs, by the published code's rule.

    Attributes:
        method: the method's name.
        published: the name of the published row; empty for none.
        env_ids: the columns' environments, in the registry's order.
        means: (runs, environments), each run's mean score; NaN where it was not evaluated.
        track: `P`, `R` or `X`, or empty (`magical.runs`).
        statements: whose demonstrations, and how often test variants were evaluated before.
    """

    method: str
    published: str
    env_ids: tuple[EnvId, ...]
    means: Floats
    track: str = ""
    statements: Statements = UNSTATED

    @property
    def label(self) -> str:
        """The method's name with its marks."""
        return self.method + marks(self.statements, self.track)

    def on(self, env_ids: Sequence[EnvId]) -> Floats:
        """The means in some of the environments, of the runs that have any of them."""
        table = self.means[:, [self.env_ids.index(env_id) for env_id in env_ids]]
        chosen: Floats = table[~np.isnan(table).all(axis=1)]
        return chosen

    def runs_in(self, env_id: EnvId) -> Floats:
        """(runs,), the means in one environment of the runs that were evaluated there."""
        return self.on([env_id])[:, 0]


def published_row(method: str) -> str:
    """The published row that a method is held against; empty for none.

    That of its name; `BC (ST), scripted experts` is held against `BC (ST)`.
    """
    names = (name for name in published_methods() if f"{method}, ".startswith(f"{name}, "))
    return next(names, "")


def reproduced_row(method: str) -> str:
    """The published row that a method is meant to reproduce; empty for none.

    That of its name, with the settings of `quick` or of the published code.
    """
    name = method.removesuffix(f", {CODE}")
    return name if name in published_methods() else ""


def make_rows(found: Found) -> tuple[list[MethodRuns], list[Rejected]]:
    """A row for each method, and the entries that count nowhere, with the reasons."""
    rejected = [Rejected(str(item.folder), "", [item.reason]) for item in found.skipped]
    groups: dict[str, list[Result]] = {}
    for result in found.results:
        runs = groups.setdefault(result.entry.method, [])
        reasons = _faults(result)
        if other := same_run(result, runs):
            reasons.append(f"the same run as {other.folder}: each run counts once")
        elif runs and (other_source := mismatch(result.entry, runs[0])):
            reasons.append(other_source)
        if reasons:
            rejected.append(Rejected(str(result.folder), result.entry.method, reasons))
        else:
            runs.append(result)
    return [_row(method, runs) for method, runs in groups.items() if runs], rejected


def _faults(result: Result) -> list[str]:
    """Why an entry cannot be compared with the published tables."""
    entry, faults = result.entry, []
    if nudge := entry.evaluated.nudge:
        faults.append(f"nudge {nudge:g}, expected 0: published scores are of the exact scene")
    for name in entry.tasks:
        task = get_task(name)
        if not is_comparable(task, entry):
            steps = task.resolve_horizon("published")
            faults.append(f"{name} with another horizon than {steps} control steps")
    return [*faults, *incompleteness(entry)]


def _row(method: str, runs: Sequence[Result]) -> MethodRuns:
    scores = [run.entry.scores for run in runs]
    found = {env_id for run in scores for env_id in by_environment(run)}
    env_ids = tuple(env_id for env_id in environments() if env_id in found)
    entries = [run.entry for run in runs]
    return MethodRuns(
        method,
        published_row(method),
        env_ids,
        run_means(scores, env_ids, PUBLISHED_RULE),
        track_of(entries[0].record.learned_from or ()),
        gather_statements(entries),
    )
