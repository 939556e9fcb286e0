"""What executing a plan would do: its runs, their estimated cost, and what is already done.

Estimates are for this machine, and accurate to within a factor of about two.
"""

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.runs.plan import in_words
from magical_baselines import Config
from magical_baselines.config import DemonstrationConfig, NetworkConfig
from magical_baselines.experiments.display import duration
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.results import DONE, FAILED, planned_states

HEADER = ("method", "tasks", "seed", "time", "state")
Way = tuple[str, str, str, str, int]  # network, observation, device, precision, threads
ROUNDS = 2  # timed batches for each network
FORWARD = 1 / 3  # time of a forward pass / that of a forward and backward pass

# In behavioural cloning, rendering and augmenting 32 samples takes 25 to 50 ms on one core; an
# environment with pixels runs 7,500 steps per second (docs/benchmarks.md).
SECONDS_PER_PREPARED_SAMPLE = 1.2e-3
SECONDS_PER_STEP = 1 / 7_500

SOURCE = (
    "estimated from the networks' training speed, measured just now on this machine, assuming that "
    "each run has a core to itself; for learners without such a network, from times measured "
    "elsewhere"
)


@dataclass(frozen=True, slots=True)
class Forecast:
    """The runs of a plan, with the estimated seconds and the state of each.

    Attributes:
        out: the results folder.
        runs: each run, its estimated seconds and its state.
        kept: the states of runs that would not be run again.
    """

    out: Path
    runs: Sequence[tuple[PlannedRun, float, str]]
    kept: Sequence[str]

    def rows(self) -> list[tuple[str, ...]]:
        """A row of `HEADER` for each run."""
        return [
            (run.method, in_words(run.tasks), str(run.seed), duration(seconds), state)
            for run, seconds, state in self.runs
        ]

    def lines(self) -> Iterator[str]:
        """The totals, and where the estimates come from."""
        states = Counter(state for _, _, state in self.runs)
        counts = ", ".join(f"{number} {state}" for state, number in states.items())
        yield f"{len(self.runs)} runs in {self.out}: {counts}"
        left = sum(seconds for _, seconds, state in self.runs if state not in self.kept)
        yield f"time left, one run at a time: {duration(left)}"
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


def estimate(runs: Sequence[PlannedRun]) -> list[float]:
    """The seconds that each run takes in a process of its own, with its number of threads.

    Takes some seconds to measure the networks' training speed.
    """
    ways = {_way(run.config) for run in runs if not run.config.seconds_each}
    speeds = _measure(ways)
    return [_estimate(run, speeds.get(_way(run.config), math.nan)) for run in runs]


def _estimate(run: PlannedRun, speed: float) -> float:
    """An estimate from the samples per second of forward and backward passes here."""
    config = run.config
    horizon, env_ids = run.evaluation.horizon, run.evaluation.env_ids
    evaluated = run.evaluation.rollouts * sum(i.task_spec.resolve_horizon(horizon) for i in env_ids)
    samples, steps = config.training_samples, config.environment_steps + evaluated
    if config.seconds_each:
        per_sample, per_action = config.seconds_each
        return samples * per_sample + steps * (per_action + SECONDS_PER_STEP)
    cloning = isinstance(config, DemonstrationConfig) and not config.environment_steps
    prepared = samples if cloning and not config.observes_vectors else 0
    learning = (samples + FORWARD * steps) / speed + prepared * SECONDS_PER_PREPARED_SAMPLE
    return learning + steps * SECONDS_PER_STEP


def _way(config: Config) -> Way:
    from magical_baselines.compute import choose_compute, choose_device

    device = choose_device(config.device)
    compute = choose_compute(device, config.network_precision, config.num_threads)
    threads = compute.threads if device == "cpu" else 0
    network = config.network if isinstance(config, NetworkConfig) else "paper"
    return network, config.observation, device, compute.precision, threads


def _measure(ways: set[Way]) -> dict[Way, float]:
    """Samples per second of forward and backward passes."""
    from magical_baselines.speed import training_speeds

    found: dict[Way, float] = {}
    for network, observation, device, threads in {(*way[:3], way[4]) for way in ways}:
        # For one thread, processor time is measured: other load on the machine does not matter.
        clock = time.process_time if threads == 1 else time.perf_counter
        speeds = training_speeds(
            network,
            device=device,
            rounds=ROUNDS,
            threads=(threads,),
            clock=clock,
            observation=observation,
        )
        for compute, speed in speeds.items():
            found[network, observation, device, compute.precision, threads] = speed
    return found
