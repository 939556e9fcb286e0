"""Measures control steps per second with random actions, resets included.

python benchmarks/stepping.py [--env ID] [--num-envs N] [--workers N] [--seconds S]

One environment and a vector environment, each with pixels and with the state vector only, take
turns, so that other load on the machine affects all alike.
"""

import argparse
import time
from typing import Any

import numpy as np

from magical.envs import parse_env_id
from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.scene import NUM_ACTIONS

TURN = 50  # steps of each environment in turn


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--env", default="magical/ClusterColour-Demo-LoRes4E-v0", metavar="ID")
    parser.add_argument("--num-envs", type=int, default=32, metavar="N")
    parser.add_argument("--workers", type=int, metavar="N", help="default: one per core")
    parser.add_argument("--seconds", type=float, default=15.0, metavar="S", help="of all together")
    arguments = parser.parse_args()
    env_id, count = parse_env_id(arguments.env), arguments.num_envs
    envs: dict[str, tuple[Any, int]] = {}
    for name, preset in (("with pixels", env_id.preset), ("state only", "state")):
        one = MagicalEnv(env_id.task, env_id.variant, observation=preset)
        many = MagicalVectorEnv([env_id] * count, workers=arguments.workers, observation=preset)
        envs[f"1 environment, {name}"] = one, 1
        envs[f"{count} environments, {many.workers} workers, {name}"] = many, count
    for env, _ in envs.values():
        env.reset(seed=0)
    for name, rate in measure(envs, arguments.seconds).items():
        print(f"{name:44} {rate:8,.0f} steps/s")
    for env, _ in envs.values():
        env.close()


def measure(envs: dict[str, tuple[Any, int]], seconds: float) -> dict[str, float]:
    """Steps of single environments per second, by name."""
    rng = np.random.default_rng(0)
    elapsed, steps = dict.fromkeys(envs, 0.0), dict.fromkeys(envs, 0)
    end = None
    while end is None or time.perf_counter() < end:
        for name, (env, count) in envs.items():
            actions = rng.integers(NUM_ACTIONS, size=(TURN, count))
            began = time.perf_counter()
            take(env, actions)
            if end is not None:  # the first turn warms up
                elapsed[name] += time.perf_counter() - began
                steps[name] += actions.size
        end = end or time.perf_counter() + seconds
    return {name: steps[name] / elapsed[name] for name in envs}


def take(env: Any, actions: Any) -> None:
    """Take steps; a single environment is reset at the end of its episode."""
    for row in actions:
        if isinstance(env, MagicalVectorEnv):
            env.step(row)
        elif env.step(row[0])[3]:
            env.reset()


if __name__ == "__main__":
    main()
