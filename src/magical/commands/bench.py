"""Measure control steps per second, compared with the bare physics, or the speed of training.

`env` and `vector`: three copies take turns with random actions. One observes pixels, one the state
vector, and one is the bare simulation of a single environment, in which only the time inside its
steps is counted: the rate that a worker would reach if nothing else took time. For the other two,
the measured time includes resetting episodes.

`training`: all precisions and numbers of threads take turns on the same batches of a network.
"""

import argparse
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import asdict
from typing import Any

import numpy as np

from magical.commands._common import (
    add_count,
    add_json,
    add_number,
    add_seed,
    add_workers,
    print_json,
    print_table,
)
from magical.envs import EnvId, parse_env_id
from magical.observe import make_spec
from magical.scene.actions import NUM_ACTIONS

HELP = "measure environment steps per second, or training speed"
DEFAULT_ENV = "magical/ClusterColour-Demo-LoRes4E-v0"
WARM_UP = 5  # steps before anything is measured: caches, compilation
PROBE = 20  # steps in the first turns, from which the length of later turns is computed
TURN = 0.2  # seconds of each copy's turn: short, so that noise affects all alike


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "kind",
        choices=("env", "vector", "training"),
        help="env: one environment; vector: many; training: forward and backward passes",
    )
    parser.add_argument(
        "--env",
        default=DEFAULT_ENV,
        metavar="ID",
        help="env, vector: environment id (default: %(default)s)",
    )
    add_count(parser, "--num-envs", "vector: number of sub-environments", default=32)
    add_workers(parser)
    add_number(
        parser, "--seconds", "env, vector: seconds to measure for", default=15.0, metavar="S"
    )
    add_seed(parser, "env, vector: seed of scenes and actions")
    parser.add_argument(
        "--network", default="paper", help="training: network architecture (default: paper)"
    )
    add_count(parser, "--batch-size", "training: samples per batch", default=32)
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda"),
        default="auto",
        help="training: device to compute on (default: auto)",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.kind == "training":
        return _run_training(args)
    env_id = parse_env_id(args.env)
    num_envs, workers = (args.num_envs, args.workers) if args.kind == "vector" else (1, 0)
    result = measure(env_id, args.kind, num_envs, workers, args.seconds, args.seed)
    copies = max(1, result["workers"])
    physics = result["physics_steps_per_second"] * copies
    rates = {
        "with pixels": result["steps_per_second"],
        "state only": result["state_steps_per_second"],
        "bare physics": physics,
    }
    rows = [
        (name, f"{rate:,.0f}", f"{1e6 * copies / rate:.1f}", f"{rate / physics:.3f}")
        for name, rate in rates.items()
    ]
    print(f"{env_id}, num_envs {num_envs}, workers {result['workers']}")
    print_table(("", "steps/s", "us/step per worker", "relative to bare physics"), rows)
    print(f"{result['frames_per_second']:,.0f} frames/s")
    print_json(args, result)
    return 0


def measure(
    env_id: EnvId, kind: str, num_envs: int, workers: int | None, seconds: float, seed: int
) -> dict[str, Any]:
    """The rates, in control steps of single environments per second; that of physics for one core.

    Returns plain data for JSON.
    """
    from magical.physics import Simulation

    def make(observation: str | None = None) -> Any:
        env = stack.enter_context(
            closing(_make(env_id, kind, num_envs, workers, observation or env_id.preset))
        )
        env.reset(seed=seed)
        return env

    def turns(env: Any) -> _Turns:
        def step(actions: Any) -> None:
            if env.step(actions[0])[3]:
                env.reset()

        return _Turns(step if kind == "env" else env.step, num_envs, seed)

    with ExitStack() as stack:
        env, task, rng = make(), env_id.task_spec, np.random.default_rng(seed)
        pixels, states = turns(env), turns(make(observation="state"))
        simulation = Simulation(*task.sample(env_id.variant, rng))
        bare = _Turns(lambda actions: simulation.step(int(actions[0])), 1, seed)
        end = time.perf_counter() + seconds
        steps = PROBE
        while time.perf_counter() < end or steps == PROBE:
            for one in (pixels, states):
                one.take(steps)
            simulation = Simulation(*task.sample(env_id.variant, rng))  # not timed
            bare.take(task.horizon)
            steps = max(1 + PROBE, round(TURN * pixels.rate))
    rate = pixels.rate * num_envs
    return {
        "env_id": env_id,
        "num_envs": num_envs,
        "workers": getattr(env, "workers", 0),
        "steps_per_second": rate,
        "state_steps_per_second": states.rate * num_envs,
        "physics_steps_per_second": bare.rate,
        "frames_per_second": rate * make_spec(env_id.preset, env_id.task_spec).num_images,
    }


def _make(
    env_id: EnvId, kind: str, num_envs: int, workers: int | None, observation: str | None
) -> Any:
    from magical.envs.env import MagicalEnv
    from magical.envs.vector import MagicalVectorEnv

    if kind == "env":
        return MagicalEnv(env_id.task, env_id.variant, observation=observation)
    return MagicalVectorEnv([env_id] * num_envs, workers=workers, observation=observation)


class _Turns:
    """The steps of one copy so far. The same seed and `num_envs` give the same actions."""

    def __init__(self, step: Callable[[Any], object], num_envs: int, seed: int) -> None:
        self._step, self._num_envs = step, num_envs
        self._rng = np.random.default_rng(seed)
        self._steps, self._seconds = 0, 0.0
        for actions in self._actions(WARM_UP):
            step(actions)

    @property
    def rate(self) -> float:
        """Steps of the whole batch per second."""
        return self._steps / self._seconds

    def take(self, steps: int) -> None:
        """Take a turn of `steps` steps of the whole batch."""
        actions = self._actions(steps)
        began = time.perf_counter()
        for row in actions:
            self._step(row)
        self._seconds += time.perf_counter() - began
        self._steps += steps

    def _actions(self, steps: int) -> Iterable[Any]:
        return self._rng.integers(0, NUM_ACTIONS, (steps, self._num_envs))


def _run_training(args: argparse.Namespace) -> int:
    """Measure training, print, recommend options for `magical train`."""
    from magical.learning.running.devices import choose_compute
    from magical.learning.running.speed import training_speeds

    speeds = training_speeds(args.network, args.batch_size, args.device)
    fastest = max(speeds, key=lambda way: speeds[way])
    default = choose_compute(fastest.device, "auto", 0)
    rows = []
    for way, speed in speeds.items():
        notes = [name for name, one in (("default", default), ("fastest", fastest)) if one == way]
        row = (way.device, way.precision, way.threads or "", f"{speed:,.0f}", " and ".join(notes))
        rows.append(row)
    print(f"network {args.network}, batches of {args.batch_size}, forward and backward passes")
    print_table(("device", "precision", "threads", "samples/s", ""), rows)
    options = f"--precision {fastest.precision}"
    if fastest.threads:
        options += f" --threads {fastest.threads}"
    print(f"fastest: magical train ... {options}")
    ways = [{**asdict(way), "samples_per_second": speed} for way, speed in speeds.items()]
    print_json(args, {"network": args.network, "batch_size": args.batch_size, "ways": ways})
    return 0
