"""Measure control steps per second beside the bare physics.

Three copies of the same worlds take the same actions by turns: one shows pixels, one the state
vector only, and one shows pixels while the time inside pymunk's `Space.step` is measured. The bare
physics rate is what a worker would reach if only that time counted. Episodes begin anew within the
measured time.
"""

import argparse
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from magical.commands._common import (
    add_json,
    non_negative_int,
    positive_int,
    print_json,
    print_table,
)
from magical.envs import parse_env_id
from magical.observe import PixelSpec, parse_observation
from magical.scene.actions import NUM_ACTIONS

HELP = "measure steps per second"
DEFAULT_ENV = "magical/ClusterColour-Demo-LoRes4E-v0"
WARM_UP = 5  # steps before anything is measured: caches, compilation
PROBE = 20  # steps of the first turns, which show how many make a turn
TURN = 0.2  # seconds of each copy's turn: short, so that noise falls on all alike


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("kind", choices=("env", "vector"), help="one environment, or many")
    parser.add_argument("--env", default=DEFAULT_ENV, metavar="ID", help=f"default: {DEFAULT_ENV}")
    parser.add_argument(
        "--num-envs", type=positive_int, default=32, metavar="N", help="vector: default 32"
    )
    parser.add_argument(
        "--workers", type=non_negative_int, metavar="K", help="vector: default one for each core"
    )
    parser.add_argument(
        "--seconds", type=float, default=15.0, metavar="S", help="to measure for (default: 15)"
    )
    parser.add_argument("--seed", type=non_negative_int, default=0, help="default: 0")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    env_id = str(parse_env_id(args.env))
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
    print(f"{env_id}, {num_envs} worlds, {result['workers']} workers")
    print_table(("", "steps/s", "us/step a worker", "of bare physics"), rows)
    print(f"{result['frames_per_second']:,.0f} frames/s")
    if args.json:
        print_json(result)
    return 0


def measure(
    env_id: str, kind: str, num_envs: int, workers: int | None, seconds: float, seed: int
) -> dict[str, Any]:
    """The rates, each in control steps of one world per second; that of physics for one worker."""

    def make(**options: Any) -> _Driven:
        if kind == "env":
            return _One(env_id, seed, **options)
        return _Many(env_id, seed, num_envs=num_envs, workers=workers, **options)

    copies = [make(), make(observation="state"), make()]
    try:
        shown, state, timed = (_Turns(copy, num_envs, seed) for copy in copies)
        end = time.perf_counter() + seconds
        steps = PROBE
        while time.perf_counter() < end or steps == PROBE:
            shown.take(steps)
            state.take(steps)
            timed.take(steps, timing_physics=True)
            steps = max(1 + PROBE, round(TURN * shown.rate))
    finally:
        for copy in copies:
            copy.close()
    used = copies[0].workers
    rate = shown.rate * num_envs
    return {
        "env_id": env_id,
        "num_envs": num_envs,
        "workers": used,
        "steps_per_second": rate,
        "state_steps_per_second": state.rate * num_envs,
        # Workers measure side by side, so that their seconds add up as their steps do.
        "physics_steps_per_second": timed.steps * num_envs / timed.physics,
        "frames_per_second": rate * _frames(env_id),
    }


class _Driven(Protocol):
    """One environment or a batch, reset and ready."""

    @property
    def workers(self) -> int: ...

    def step(self, actions: Any) -> Any: ...

    def time_physics(self, on: bool) -> float: ...

    def close(self) -> None: ...


class _One:
    """A single environment that begins anew by itself."""

    workers = 0

    def __init__(self, env_id: str, seed: int, **options: Any) -> None:
        import gymnasium

        from magical.physics.clock import PhysicsClock

        self._env = gymnasium.make(env_id, **options).unwrapped
        self._env.reset(seed=seed)
        self._clock = PhysicsClock()
        self.close = self._env.close

    def step(self, actions: Any) -> None:
        if self._env.step(actions[0])[3]:
            self._env.reset()

    def time_physics(self, on: bool) -> float:
        (self._clock.start if on else self._clock.stop)()
        return self._clock.seconds


class _Many:
    """A vector environment."""

    def __init__(self, env_id: str, seed: int, **options: Any) -> None:
        import gymnasium

        env: Any = gymnasium.make_vec(env_id, **options).unwrapped
        env.reset(seed=seed)
        self.workers: int = env.workers
        self.step, self.time_physics, self.close = env.step, env.time_physics, env.close


@dataclass
class _Turns:
    """What one copy has done so far. Copies with the same seed get the same actions."""

    driven: _Driven
    num_envs: int
    seed: int
    steps: int = 0
    seconds: float = 0.0
    physics: float = 0.0  # seconds inside the physics, summed over workers, while it was timed

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        for actions in self._actions(WARM_UP):
            self.driven.step(actions)

    @property
    def rate(self) -> float:
        """Steps of the whole batch per second."""
        return self.steps / self.seconds

    def take(self, steps: int, timing_physics: bool = False) -> None:
        """Take a turn of so many steps of the whole batch."""
        actions = self._actions(steps)
        before = self.driven.time_physics(timing_physics)
        began = time.perf_counter()
        for row in actions:
            self.driven.step(row)
        self.seconds += time.perf_counter() - began
        self.steps += steps
        self.physics += self.driven.time_physics(False) - before

    def _actions(self, steps: int) -> Iterable[Any]:
        return self._rng.integers(0, NUM_ACTIONS, (steps, self.num_envs))


def _frames(env_id: str) -> int:
    """How many frames are drawn for one step: one for each view."""
    form = parse_observation(parse_env_id(env_id).preset)
    return len(form.parts) if isinstance(form, PixelSpec) else 0
