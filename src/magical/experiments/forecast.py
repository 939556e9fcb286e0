"""What executing a plan would do: its runs, their estimated cost, and what is already done."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.experiments.display import duration
from magical.experiments.estimates import SOURCES, Estimate, estimate
from magical.experiments.plan import PlannedRun, in_words
from magical.experiments.results import DONE, FAILED, planned_states

HEADER = ("method", "tasks", "seed", "here", "one GPU", "state")


@dataclass(frozen=True, slots=True)
class Forecast:
    """The runs of a plan, with the estimate and the state of each.

    Attributes:
        out: the results folder.
        runs: of the plan.
        estimates: of each.
        states: of each.
        kept: the states of runs that would not be run again.
    """

    out: Path
    runs: Sequence[PlannedRun]
    estimates: Sequence[Estimate]
    states: Sequence[str]
    kept: Sequence[str] = (DONE, FAILED)

    def rows(self) -> list[tuple[str, ...]]:
        """A row of `HEADER` for each run."""
        return [
            (
                run.method,
                in_words(run.tasks),
                str(run.seed),
                duration(cost.here),
                duration(cost.gpu),
                state,
            )
            for run, cost, state in self._items()
        ]

    def lines(self) -> Iterator[str]:
        """The totals, and where the estimates are from."""
        counts = ", ".join(f"{number} {state}" for state, number in Counter(self.states).items())
        yield f"{len(self.runs)} runs in {self.out}: {counts}"
        left = [cost for _, cost, state in self._items() if state not in self.kept]
        here, gpu = sum(cost.here for cost in left), sum(cost.gpu for cost in left)
        yield f"left, one run at a time: {duration(here)} here, {duration(gpu)} on one GPU"
        yield from SOURCES

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        plan = [
            {
                "method": run.method,
                "tasks": list(run.tasks),
                "seed": run.seed,
                "folder": run.folder,
                "state": state,
                "seconds": round(cost.here, 3),
                "gpu_seconds": round(cost.gpu, 3),
            }
            for run, cost, state in self._items()
        ]
        return {"runs": len(plan), "plan": plan, "out": str(self.out), "estimates": list(SOURCES)}

    def _items(self) -> Iterator[tuple[PlannedRun, Estimate, str]]:
        return zip(self.runs, self.estimates, self.states, strict=True)


def forecast(runs: Sequence[PlannedRun], out: Path, *, retry_failed: bool = False) -> Forecast:
    """What executing these runs in a results folder, which need not exist, would do.

    Raises:
        ResultsError: the folder could not be used for these runs.
    """
    states = planned_states(out, runs)
    kept = (DONE,) if retry_failed else (DONE, FAILED)
    return Forecast(out, runs, estimate(runs), states, kept)
