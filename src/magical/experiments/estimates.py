"""Estimates of how long runs take on this machine: right within a factor of two or so."""

import math
import time
from collections.abc import Sequence

from magical.experiments.plan import PlannedRun
from magical.learning import Config
from magical.learning.config import DemonstrationSettings, NetworkSettings

ROUNDS = 2  # timed batches of a network
FORWARD = 1 / 3  # time of a forward pass, of that of a forward and backward pass

# Rendering and augmenting a sample of behavioural cloning takes 25 to 50 ms of a core for 32 of
# them; 7,500 steps a second of an environment with its pixels (docs/benchmarks.md).
SECONDS_PER_PREPARED_SAMPLE = 1.2e-3
SECONDS_PER_STEP = 1 / 7_500

SOURCE = (
    "estimated from the training speed of the networks, measured just now on this machine, for a "
    "core that a run has to itself; for a learner without such a network, from what it took "
    "elsewhere"
)


def estimate(runs: Sequence[PlannedRun]) -> list[float]:
    """The seconds that each run takes in a process of its own, with its number of threads.

    Takes some seconds to measure the networks' training speed.
    """
    ways = {_way(run.config) for run in runs if not run.config.seconds_each}
    speeds = _measure(ways)
    return [_estimate(run, speeds.get(_way(run.config), math.nan)) for run in runs]


def _estimate(run: PlannedRun, speed: float) -> float:
    """An estimate from the samples a second of forward and backward passes here."""
    config = run.config
    samples, steps = config.training_samples, config.environment_steps + _evaluation_steps(run)
    if config.seconds_each:
        per_sample, per_action = config.seconds_each
        return samples * per_sample + steps * (per_action + SECONDS_PER_STEP)
    cloning = config.part(DemonstrationSettings) and not config.environment_steps
    prepared = samples if cloning else 0
    learning = (samples + FORWARD * steps) / speed + prepared * SECONDS_PER_PREPARED_SAMPLE
    return learning + steps * SECONDS_PER_STEP


def _evaluation_steps(run: PlannedRun) -> int:
    """The control steps of all rollouts after training."""
    evaluation = run.evaluation
    horizon = evaluation.horizon
    steps = (env_id.task_spec.resolve_horizon(horizon) for env_id in evaluation.env_ids)
    return evaluation.rollouts * sum(steps)


def _way(config: Config) -> tuple[str, str, str, int]:
    """What the speed depends on: network, device, precision, threads."""
    from magical.learning.running.devices import choose_compute, choose_device

    device = choose_device(config.device)
    compute = choose_compute(device, config.precision, config.threads)
    threads = compute.threads if device == "cpu" else 0
    networks = config.part(NetworkSettings)
    network = networks.network if networks else "paper"
    return network, device, compute.precision, threads


def _measure(ways: set[tuple[str, str, str, int]]) -> dict[tuple[str, str, str, int], float]:
    """Samples a second of forward and backward passes."""
    from magical.learning.running.speed import training_speeds

    found: dict[tuple[str, str, str, int], float] = {}
    for network, device, threads in {(network, device, n) for network, device, _, n in ways}:
        # Of one thread, the processor time is measured: what else runs here does not matter.
        clock = time.process_time if threads == 1 else time.perf_counter
        speeds = training_speeds(
            network, device=device, rounds=ROUNDS, threads=(threads,), clock=clock
        )
        for compute, speed in speeds.items():
            found[network, device, compute.precision, threads] = speed
    return found
