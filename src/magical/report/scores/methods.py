"""The entries' methods, on the environments that they have in common."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.evaluation import Entry
from magical.evaluation.intervals import Floats, Interval, weighted_sum
from magical.evaluation.statistics import (
    by_environment,
    difference,
    gap_weights,
    generalisation_gap,
    mean,
    over_rollouts,
    run_means,
)
from magical.report.found.rows import by_row
from magical.report.found.statements import marked


@dataclass(frozen=True, slots=True)
class ComparedMethod:
    """One method's runs on the compared environments."""

    name: str  # with its marks
    runs: Sequence[Entry]
    env_ids: Sequence[EnvId]
    means: Floats  # (runs, environments); NaN where a run was not evaluated

    @property
    def several(self) -> bool:
        """Whether any environment has several runs."""
        return bool(self._counts.max() > 1)

    @property
    def fewest_runs(self) -> int:
        """The smallest number of runs in any environment."""
        return int(self._counts.min())

    @property
    def unit(self) -> str:
        """What intervals are over, in words."""
        if not self.several:
            return "rollouts of 1 run"
        fewest, most = self._counts.min(), self._counts.max()
        return f"{fewest} runs" if fewest == most else f"{fewest} to {most} runs"

    def mean(self) -> Interval:
        """The mean, with an interval over runs, or over rollouts if every environment has one run.

        If environments have several runs, the interval has no bounds when a run is the only one
        with its set of environments.
        """
        if self.several:
            return mean(self.means)
        return self._over_rollouts(np.full(len(self.env_ids), 1 / len(self.env_ids)))

    def generalisation_gap(self, variant: str = "TestAll") -> Interval | None:
        """The generalisation gap, as `mean`; `None` if no task has both Demo and the variant."""
        try:
            weights = gap_weights(self.env_ids, variant)
        except ValueError:
            return None
        if self.several:
            return generalisation_gap(self.means, self.env_ids, variant)
        return self._over_rollouts(weights)

    def difference(self, other: "ComparedMethod") -> Interval:
        """This method's mean minus another's, with an interval over runs if both have several."""
        if self.several and other.several:
            return difference(self.means, other.means)
        return weighted_sum([self.mean(), other.mean()], [1.0, -1.0])

    def on(self, env_ids: Sequence[EnvId]) -> "ComparedMethod":
        """The same method on some of its environments."""
        return _method(self.name, self.runs, env_ids)

    @property
    def _counts(self) -> NDArray[np.int64]:
        """The number of runs in each environment, (environments,)."""
        counts: NDArray[np.int64] = (~np.isnan(self.means)).sum(axis=0)
        return counts

    def _over_rollouts(self, weights: Floats) -> Interval:
        return over_rollouts([run.scores for run in self.runs], self.env_ids, weights)


def compared_methods(entries: Iterable[Entry]) -> list[ComparedMethod]:
    """Every method on the environments that all of them have; empty if there are none.

    Methods are the rows of `by_row`: evaluations that differ are compared like methods. A row's
    runs are each on all of its tasks or on some; it has an environment if all its runs on that
    task do, so a mean over environments is over the same ones for all runs of a task.
    """
    return compared_rows(by_row(entries, lambda entry: entry))


def compared_rows(rows: Mapping[str, Sequence[Entry]]) -> list[ComparedMethod]:
    """As `compared_methods`, for rows given by their labels."""
    found = [_environments(runs) for runs in rows.values()]
    shared = [env_id for env_id in (found[0] if found else []) if all(env_id in i for i in found)]
    return (
        [_method(marked(name, group), group, shared) for name, group in rows.items()]
        if shared
        else []
    )


def _method(name: str, group: Sequence[Entry], env_ids: Sequence[EnvId]) -> ComparedMethod:
    runs = [entry for entry in group if any(row.env_id in env_ids for row in entry.scores)]
    return ComparedMethod(name, runs, env_ids, run_means([run.scores for run in runs], env_ids))


def _environments(runs: Sequence[Entry]) -> list[EnvId]:
    """The environments that all of a method's runs on their task have, in order of appearance."""
    found = [list(by_environment(run.scores)) for run in runs]
    counts = Counter(env_id for env_ids in found for env_id in env_ids)
    tasks = Counter(task for env_ids in found for task in {env_id.task for env_id in env_ids})
    return [env_id for env_id in counts if counts[env_id] == tasks[env_id.task]]
