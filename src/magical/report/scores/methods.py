"""The entries' methods, on the environments that they have in common."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.evaluation import Entry
from magical.evaluation.intervals import (
    FEWEST_RUNS,
    Floats,
    Interval,
    OverRollouts,
    weighted_sum,
)
from magical.evaluation.statistics import (
    by_environment,
    difference,
    gap_weights,
    generalisation_gap,
    interquartile_mean,
    mean,
    over_rollouts,
    run_means,
)
from magical.grouping import group_by
from magical.report.found.rows import by_row
from magical.report.found.statements import marked
from magical.report.scores.tables import means_apart


@dataclass(frozen=True, slots=True)
class ComparedMethod:
    """One method's runs on the compared environments."""

    name: str  # with its marks
    runs: Sequence[Entry]
    env_ids: Sequence[EnvId]
    means: Floats  # (runs, environments); NaN where a run was not evaluated

    @property
    def over_runs(self) -> bool:
        """Whether every environment has enough runs for an interval over them."""
        return bool(self._counts.min() >= FEWEST_RUNS)

    @property
    def fewest_runs(self) -> int:
        """The smallest number of runs in any environment."""
        return int(self._counts.min())

    @property
    def unit(self) -> str:
        """What intervals are over, in words."""
        fewest, most = self._counts.min(), self._counts.max()
        count = f"{fewest}" if fewest == most else f"{fewest} to {most}"
        runs = f"{count} run{'s' if most > 1 else ''}"
        return runs if self.over_runs else f"rollouts of {runs}"

    def mean(self) -> Interval:
        """The mean, with an interval over runs.

        It is over rollouts (`OverRollouts`) if an environment has fewer than `FEWEST_RUNS` runs, if
        the runs do not differ, or if a run is the only one with its set of environments.
        """
        return self._shown(mean(self.means)) or self._over_rollouts(self._equal_weights)

    def generalisation_gap(self, variant: str = "TestAll") -> Interval | None:
        """The generalisation gap, as `mean`; `None` if no task has both Demo and the variant."""
        try:
            weights = gap_weights(self.env_ids, variant)
        except ValueError:
            return None
        found = generalisation_gap(self.means, self.env_ids, variant)
        return self._shown(found) or self._over_rollouts(weights)

    def interquartile_mean(self) -> Interval:
        """The interquartile mean; without bounds where the interval would not be over runs."""
        return self._over_runs_only(interquartile_mean(self.means))

    def difference(self, other: "ComparedMethod") -> Interval:
        """This method's mean minus another's; over runs if both means are."""
        means = [self.mean(), other.mean()]
        if any(isinstance(each, OverRollouts) for each in means):
            return OverRollouts(*weighted_sum(means, [1.0, -1.0]))
        return difference(self.means, other.means)

    def means_apart(self) -> str:
        """The runs' means where a few of them differ much, as text; otherwise empty."""
        return self._apart(self._equal_weights)

    def gaps_apart(self, variant: str = "TestAll") -> str:
        """The runs' generalisation gaps where a few of them differ much, as text."""
        return self._apart(gap_weights(self.env_ids, variant))

    def on(self, env_ids: Sequence[EnvId]) -> "ComparedMethod":
        """The same method on some of its environments."""
        return make_method(self.name, self.runs, env_ids)

    @property
    def _counts(self) -> NDArray[np.int64]:
        """The number of runs in each environment, (environments,)."""
        counts: NDArray[np.int64] = (~np.isnan(self.means)).sum(axis=0)
        return counts

    @property
    def _equal_weights(self) -> Floats:
        return np.full(len(self.env_ids), 1 / len(self.env_ids))

    def _shown(self, found: Interval) -> Interval | None:
        """An interval over runs; `None` for too few runs, or if it has no bounds."""
        return found if self.over_runs and not math.isnan(found.low) else None

    def _over_runs_only(self, found: Interval) -> Interval:
        return self._shown(found) or Interval(found.value, np.nan, np.nan)

    def _over_rollouts(self, weights: Floats) -> OverRollouts:
        return over_rollouts([run.scores for run in self.runs], self.env_ids, weights)

    def _apart(self, weights: Floats) -> str:
        """The values of runs on the same environments, if these are apart; with their tasks."""
        strata = group_by(
            self.means, lambda run: tuple(np.flatnonzero(~np.isnan(run) * weights).tolist())
        )
        texts = []
        for places, runs in strata.items():
            if not places:
                continue
            columns = list(places)
            share = weights[columns].clip(min=0.0).sum()
            listed = means_apart([float(run[columns] @ weights[columns] / share) for run in runs])
            tasks = ", ".join(dict.fromkeys(self.env_ids[place].task for place in columns))
            texts += [listed.replace("(", f"({tasks}: ") if len(strata) > 1 else listed]
        return "".join(texts)


def compared_methods(entries: Iterable[Entry]) -> list[ComparedMethod]:
    """Every method on the environments that all of them have; empty if there are none.

    Methods are the rows of `by_row`: evaluations that differ are compared like methods. A row's
    runs are each on all of its tasks or on some; it has an environment if all its runs on that
    task do, so a mean over environments is over the same ones for all runs of a task.
    """
    rows = by_row(entries, lambda entry: entry)
    found = [_environments(runs) for runs in rows.values()]
    shared = [env_id for env_id in (found[0] if found else []) if all(env_id in i for i in found)]
    return (
        [make_method(marked(name, group), group, shared) for name, group in rows.items()]
        if shared
        else []
    )


def make_method(name: str, group: Iterable[Entry], env_ids: Sequence[EnvId]) -> ComparedMethod:
    """A method's runs on some environments; runs that have none of them are left out."""
    runs = [entry for entry in group if any(row.env_id in env_ids for row in entry.scores)]
    return ComparedMethod(name, runs, env_ids, run_means([run.scores for run in runs], env_ids))


def _environments(runs: Sequence[Entry]) -> list[EnvId]:
    """The environments that all of a method's runs on their task have, in order of appearance."""
    found = [list(by_environment(run.scores)) for run in runs]
    counts = Counter(env_id for env_ids in found for env_id in env_ids)
    tasks = Counter(task for env_ids in found for task in {env_id.task for env_id in env_ids})
    return [env_id for env_id in counts if counts[env_id] == tasks[env_id.task]]
