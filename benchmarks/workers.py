"""Compares a vector environment of two threads with two independent processes, in turns.

python benchmarks/workers.py [--observation NAME] [--num-envs N] [--turns N]

Each independent process steps half of the sub-environments in one thread; both step at the same
time. Absolute rates vary with other load on the machine, ratios of neighbouring turns less so.
"""

import argparse
import pickle
import time
from typing import IO

import numpy as np

from magical.envs.vector import MagicalVectorEnv
from magical.processes import Child, serve

TASK = "magical/ClusterColour-Demo"
STEPS = 100  # per turn
WORKERS = 2


class Stepper:
    """A vector environment that takes random actions."""

    def __init__(self, observation: str, num_envs: int, workers: int) -> None:
        ids = [f"{TASK}-v0"] * num_envs
        self._env = MagicalVectorEnv(ids, workers=workers, observation=observation)
        self._env.reset(seed=0)
        self._rng = np.random.default_rng(0)

    def close(self) -> None:
        self._env.close()

    def step(self) -> float:
        """Take a turn's steps, including resets; returns sub-environment steps per second."""
        count = self._env.num_envs
        actions = self._rng.integers(18, size=(STEPS, count))
        began = time.perf_counter()
        for row in actions:
            self._env.step(row)
        return STEPS * count / (time.perf_counter() - began)


def main(requests: IO[bytes], replies: IO[bytes]) -> None:
    """Serve in an independent process: a request is (observation, num_envs), or `None` to step."""
    steppers: list[Stepper] = []

    def answer(request: tuple[str, int] | None) -> float:
        if request is not None:
            steppers.append(Stepper(*request, workers=1))
            return 0.0
        return steppers[0].step()

    serve(answer, requests, replies)


def compare(observation: str, num_envs: int, turns: int) -> None:
    """Print both median rates, and the median and quartiles of their ratio over turns."""
    together = Stepper(observation, num_envs, WORKERS)
    apart = [Child("workers", f"process {i}") for i in range(WORKERS)]
    rates = []
    try:
        _ask(apart, (observation, num_envs // WORKERS))
        for turn in range(turns + 1):
            if turn % 2:
                one, other = together.step(), sum(_ask(apart, None))
            else:
                other, one = sum(_ask(apart, None)), together.step()
            rates.append((one, other))
    finally:
        for child in apart:
            child.close()
        together.close()
    vector, independent = np.array(rates[1:]).T  # the first turn warms up
    low, middle, high = np.quantile(vector / independent, (0.25, 0.5, 0.75))
    print(
        f"{observation:8} vector {np.median(vector):6.0f} /s, independent "
        f"{np.median(independent):6.0f} /s, ratio {middle:.3f} (quartiles {low:.3f} to "
        f"{high:.3f}), {turns} turns"
    )


def _ask(children: list[Child], request: tuple[str, int] | None) -> list[float]:
    for child in children:
        child.send(pickle.dumps(request))
    replies = [child.receive() for child in children]
    for succeeded, value in replies:
        if not succeeded:
            raise value
    return [value for _, value in replies]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--observation", nargs="+", default=["LoRes4E", "state"])
    parser.add_argument("--num-envs", type=int, default=32)
    parser.add_argument("--turns", type=int, default=40)
    arguments = parser.parse_args()
    for name in arguments.observation:
        compare(name, arguments.num_envs, arguments.turns)
