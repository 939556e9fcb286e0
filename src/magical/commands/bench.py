"""Measure control steps per second beside the bare physics, or the speed of training.

`env` and `vector`: three copies take the same actions by turns. One observes pixels, one the state
vector, and one is the bare simulation of a single environment, in which only the time inside the
physics engine is counted: the rate that a worker would reach if nothing else took time. Episodes
are reset within the measured time.

`training`: every precision and number of threads takes turns on the same batches of a network.
"""

import argparse
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from magical.commands._bench_training import run_training
from magical.commands._common import (
    add_json,
    non_negative_int,
    positive_int,
    print_json,
    print_table,
)
from magical.envs import EnvId, parse_env_id
from magical.observe import make_spec
from magical.scene.actions import NUM_ACTIONS

HELP = "measure steps per second, or the speed of training"
DEFAULT_ENV = "magical/ClusterColour-Demo-LoRes4E-v0"
WARM_UP = 5  # steps before anything is measured: caches, compilation
PROBE = 20  # steps of the first turns, from which the length of a turn follows
TURN = 0.2  # seconds of each copy's turn: short, so that noise affects all alike
CALIBRATION_CALLS = 20_000


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "kind",
        choices=("env", "vector", "training"),
        help="one environment, many, or forward and backward passes of a network",
    )
    parser.add_argument(
        "--env", default=DEFAULT_ENV, metavar="ID", help=f"env, vector: default {DEFAULT_ENV}"
    )
    parser.add_argument(
        "--num-envs", type=positive_int, default=32, metavar="N", help="vector: default 32"
    )
    parser.add_argument(
        "--workers", type=non_negative_int, metavar="K", help="vector: default one for each core"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=15.0,
        metavar="S",
        help="env, vector: measuring time (default: 15)",
    )
    parser.add_argument("--seed", type=non_negative_int, default=0, help="env, vector: default 0")
    parser.add_argument("--network", default="paper", help="training: default paper")
    parser.add_argument(
        "--batch-size", type=positive_int, default=32, metavar="N", help="training: default 32"
    )
    parser.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto", help="training: default auto"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.kind == "training":
        return run_training(args)
    env_id = parse_env_id(args.env)
    num_envs, workers = (args.num_envs, args.workers) if args.kind == "vector" else (1, 0)
    result = measure(env_id, args.kind, num_envs, workers, args.seconds, args.seed)
    physics = result["physics_steps_per_second"] * max(1, result["workers"])
    rows = [
        (
            name,
            f"{rate:,.0f}",
            f"{1e6 * max(1, result['workers']) / rate:.1f}",
            f"{rate / physics:.3f}",
        )
        for name, rate in (
            ("with pixels", result["steps_per_second"]),
            ("state only", result["state_steps_per_second"]),
            ("bare physics", physics),
        )
    ]
    print(f"{env_id}, {num_envs} environments, {result['workers']} workers")
    print_table(("", "steps/s", "us/step a worker", "of bare physics"), rows)
    print(f"{result['frames_per_second']:,.0f} frames/s")
    if args.json:
        print_json(result)
    return 0


def measure(
    env_id: EnvId, kind: str, num_envs: int, workers: int | None, seconds: float, seed: int
) -> dict[str, Any]:
    """The rates, each in control steps of one environment per second; that of physics for one core.

    Returns plain data for JSON.
    """

    def make(**options: Any) -> "_Single | _Vector":
        if kind == "env":
            return _Single(env_id, seed, **options)
        return _Vector(env_id, seed, num_envs=num_envs, workers=workers, **options)

    pixels, states, physics = make(), make(observation="state"), BarePhysics(env_id, seed)
    try:
        pixel_turns, state_turns = _Turns(pixels, num_envs, seed), _Turns(states, num_envs, seed)
        physics_turns = _Turns(physics, 1, seed)
        end = time.perf_counter() + seconds
        steps = PROBE
        while time.perf_counter() < end or steps == PROBE:
            pixel_turns.take(steps)
            state_turns.take(steps)
            physics_turns.take(steps)
            steps = max(1 + PROBE, round(TURN * pixel_turns.rate))
    finally:
        pixels.close()
        states.close()
    rate = pixel_turns.rate * num_envs
    spec = make_spec(env_id.preset, env_id.task_spec)
    return {
        "env_id": env_id,
        "num_envs": num_envs,
        "workers": pixels.workers,
        "steps_per_second": rate,
        "state_steps_per_second": state_turns.rate * num_envs,
        "physics_steps_per_second": physics.rate,
        "frames_per_second": rate * spec.num_images,
    }


class _Steppable(Protocol):
    """Something that takes a batch of actions."""

    def step(self, actions: Any) -> Any: ...


class _Single:
    """A single environment that is reset at its episode's end."""

    workers = 0

    def __init__(self, env_id: EnvId, seed: int, **options: Any) -> None:
        import gymnasium

        self._env = gymnasium.make(env_id, **options).unwrapped
        self._env.reset(seed=seed)
        self.close = self._env.close

    def step(self, actions: Any) -> None:
        if self._env.step(actions[0])[3]:
            self._env.reset()


class _Vector:
    """A vector environment."""

    def __init__(self, env_id: EnvId, seed: int, **options: Any) -> None:
        import gymnasium

        env: Any = gymnasium.make_vec(env_id, **options).unwrapped
        env.reset(seed=seed)
        self.workers: int = env.workers
        self.step, self.close = env.step, env.close


class BarePhysics:
    """The simulation of one environment's episodes, with a clock around the physics engine.

    The time that the clock itself adds to a call is measured once and subtracted.
    """

    def __init__(self, env_id: EnvId, seed: int) -> None:
        self._env_id = env_id
        self._rng = np.random.default_rng(seed)
        self._clock = Clock()
        self._steps = 0
        self._reset()

    def step(self, actions: Any) -> None:
        """One control step."""
        if self._left == 0:
            self._reset()
        self._simulation.step(int(actions[0]))
        self._steps += 1
        self._left -= 1

    @property
    def rate(self) -> float:
        """Control steps per second inside the physics engine."""
        return self._steps / self._clock.seconds

    def _reset(self) -> None:
        from magical.physics import Simulation

        task = self._env_id.task_spec
        self._simulation = Simulation(*task.sample(self._env_id.variant, self._rng))
        self._simulation.advance = self._clock.around(self._simulation.advance)
        self._left = task.horizon


@dataclass
class Clock:
    """Adds up the time inside a function, less what the measurement itself takes."""

    measured: float = 0.0  # seconds
    calls: int = 0
    overhead: float = 0.0  # seconds a call

    def __post_init__(self) -> None:
        nothing = self.around(lambda duration: None)
        for _ in range(CALIBRATION_CALLS):
            nothing(0.0)
        self.overhead = self.measured / CALIBRATION_CALLS
        self.measured, self.calls = 0.0, 0

    @property
    def seconds(self) -> float:
        """Seconds inside the functions so far."""
        return self.measured - self.calls * self.overhead

    def around(self, function: Callable[[float], None]) -> Callable[[float], None]:
        """The function, timed."""
        now = time.perf_counter

        def timed(duration: float) -> None:
            began = now()
            function(duration)
            self.measured += now() - began
            self.calls += 1

        return timed


@dataclass
class _Turns:
    """The steps of one copy so far. Copies with the same seed get the same actions."""

    steppable: _Steppable
    num_envs: int
    seed: int
    steps: int = 0
    seconds: float = 0.0
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        for actions in self._actions(WARM_UP):
            self.steppable.step(actions)

    @property
    def rate(self) -> float:
        """Steps of the whole batch per second."""
        return self.steps / self.seconds

    def take(self, steps: int) -> None:
        """Take a turn of `steps` steps of the whole batch."""
        actions = self._actions(steps)
        began = time.perf_counter()
        for row in actions:
            self.steppable.step(row)
        self.seconds += time.perf_counter() - began
        self.steps += steps

    def _actions(self, steps: int) -> Iterable[Any]:
        return self._rng.integers(0, NUM_ACTIONS, (steps, self.num_envs))
