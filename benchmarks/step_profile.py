"""Profiles a control step by part, in microseconds per environment.

python benchmarks/step_profile.py [--env ID] [--num-envs N]

All sub-environments are stepped in one thread. The parts are timed one after another, each over
all sub-environments, once per round. The lowest decile is reported, as it is least affected by
other processes. The copy is the one that `copy=True` makes.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from magical.envs.vector import MagicalVectorEnv
from magical.physics.substeps import step_rows
from magical.scene import NUM_ACTIONS

ROUNDS = 100
WARM_UP = 50  # steps until robots and blocks are in contact


class Profile:
    """Seconds by part."""

    def __init__(self, num_envs: int) -> None:
        self._num_envs = num_envs
        self._seconds: dict[str, list[float]] = {}

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self._seconds.setdefault(name, []).append(time.perf_counter() - began)

    def microseconds(self, name: str) -> float:
        return float(np.quantile(self._seconds[name], 0.1)) * 1e6 / self._num_envs


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--env", default="magical/ClusterColour-Demo-LoRes4E-v0")
    parser.add_argument("--num-envs", type=int, default=32)
    arguments = parser.parse_args()
    envs = MagicalVectorEnv([arguments.env] * arguments.num_envs, workers=1)
    rng = np.random.default_rng(0)

    def sample() -> np.ndarray:
        return rng.integers(NUM_ACTIONS, size=envs.num_envs)

    envs.reset(seed=0)
    for _ in range(WARM_UP):
        envs.step(sample())
    profile = Profile(envs.num_envs)
    for _ in range(ROUNDS):
        actions = sample()
        with profile.part("step"):
            envs.step(actions)
        profile_parts(envs, sample(), profile)
    report(profile)


def profile_parts(envs: MagicalVectorEnv, actions: np.ndarray, profile: Profile) -> None:
    """Take one step, part by part; episodes are not reset at their end."""
    rows, points = np.arange(envs.num_envs), envs.action_spec.points(actions, envs.num_envs)
    with profile.part("simulation"):
        step_rows(rows, envs._robots, envs._places, points, envs._bodies)
    with profile.part("observe"):
        for env, bodies in zip(envs.envs, envs._used_bodies, strict=True):
            env.observer.update(bodies)
    copy = envs._free_copy()
    assert copy is not None
    with profile.part("copy"):
        for row in rows.tolist():
            copy.fill(row)


def report(profile: Profile) -> None:
    step = profile.microseconds("step")
    parts = {
        "simulation and reading": profile.microseconds("simulation"),
        "observation": profile.microseconds("observe"),
        "copy for the caller": profile.microseconds("copy"),
    }
    parts["everything else"] = step - sum(parts.values())
    for name, microseconds in {**parts, "step": step}.items():
        print(f"{name:30} {microseconds:7.1f} us {microseconds / step:7.1%}")


if __name__ == "__main__":
    main()
