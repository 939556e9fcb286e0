"""What executing a plan would do: its runs, their estimated cost, and what is already done."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.experiments.display import duration
from magical.experiments.estimates import SOURCE, estimate
from magical.experiments.plan import PlannedRun
from magical.experiments.results import DONE, FAILED, planned_states
from magical.runs.plan import in_words

HEADER = ("method", "tasks", "seed", "time", "state")


@dataclass(frozen=True, slots=True)
class Forecast:
    """The runs of a plan, with the estimated seconds and the state of each.

    Attributes:
        out: the results folder.
        runs: each run, its seconds, its state.
        kept: the states of runs that would not be run again.
    """

    out: Path
    runs: Sequence[tuple[PlannedRun, float, str]]
    kept: Sequence[str] = (DONE, FAILED)

    def rows(self) -> list[tuple[str, ...]]:
        """A row of `HEADER` for each run."""
        return [
            (run.method, in_words(run.tasks), str(run.seed), duration(seconds), state)
            for run, seconds, state in self.runs
        ]

    def lines(self) -> Iterator[str]:
        """The totals, and where the estimates are from."""
        states = Counter(state for _, _, state in self.runs)
        counts = ", ".join(f"{number} {state}" for state, number in states.items())
        yield f"{len(self.runs)} runs in {self.out}: {counts}"
        left = sum(seconds for _, seconds, state in self.runs if state not in self.kept)
        yield f"left, one run at a time: {duration(left)}"
        yield SOURCE

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        plan = [
            {
                "method": run.method,
                "tasks": list(run.tasks),
                "seed": run.seed,
                "folder": run.folder,
                "state": state,
                "seconds": round(seconds, 3),
            }
            for run, seconds, state in self.runs
        ]
        return {"runs": len(plan), "plan": plan, "out": str(self.out), "estimates": SOURCE}


def forecast(runs: Sequence[PlannedRun], out: Path, *, retry_failed: bool = False) -> Forecast:
    """What executing these runs in a results folder, which need not exist, would do.

    Raises:
        ResultsError: the folder could not be used for these runs.
    """
    states = planned_states(out, runs)
    kept = (DONE,) if retry_failed else (DONE, FAILED)
    return Forecast(out, list(zip(runs, estimate(runs), states, strict=True)), kept)
