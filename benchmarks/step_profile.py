"""Where the time of a control step goes, in microseconds for one world.

python benchmarks/step_profile.py [--env ID] [--num-envs N]

All worlds are stepped in this process. The parts are timed one after the other, each over all
worlds, as often as there are rounds; the lower decile is shown, which other processes disturb
least. The copy is that of `copy=True`.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from magical.envs.batch import Batch
from magical.envs.vector import MagicalVectorEnv
from magical.physics.clock import PhysicsClock
from magical.scene.actions import NUM_ACTIONS

ROUNDS = 100
WARM_UP = 50  # steps, so that robots and blocks have met


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
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--env", default="magical/ClusterColour-Demo-LoRes4E-v0")
    parser.add_argument("--num-envs", type=int, default=32)
    args = parser.parse_args()
    envs = MagicalVectorEnv([args.env] * args.num_envs, workers=0)
    envs.reset(seed=0)
    rng = np.random.default_rng(0)

    def draw() -> np.ndarray:
        return np.asarray(rng.integers(0, NUM_ACTIONS, args.num_envs))

    for _ in range(WARM_UP):
        envs.step(draw())
    profile, physics = Profile(args.num_envs), profile_physics(envs, draw)
    for _ in range(ROUNDS):
        profile_parts(envs, draw(), profile)
    for _ in range(ROUNDS):
        with profile.part("step"):
            envs.step(draw())
    show(profile, physics)


def profile_physics(envs: MagicalVectorEnv, draw: Callable[[], np.ndarray]) -> float:
    """Microseconds inside `Space.step`."""
    clock, each = PhysicsClock(), []
    for _ in range(ROUNDS):
        before = clock.seconds
        clock.start()
        envs.step(draw())
        clock.stop()
        each.append(clock.seconds - before)
    return float(np.quantile(each, 0.1)) * 1e6 / envs.num_envs


def profile_parts(envs: MagicalVectorEnv, actions: np.ndarray, profile: Profile) -> None:
    """Take one step, part by part; a world that has ended simply goes on."""
    batch = envs._batch
    assert isinstance(batch, Batch)
    worlds = batch._in_order
    with profile.part("world"):
        for world, action in zip(worlds, actions.tolist(), strict=True):
            world.episode.world.step(action)
    with profile.part("read"):
        for world in worlds:
            world.episode.table = world.episode.world.read()
    with profile.part("show"):
        for world in worlds:
            world.episode.observer.update(world.episode.table)
    with profile.part("copy"):
        for world in worlds:
            if world._copies:
                world.copy_observation(0)


def show(profile: Profile, physics: float) -> None:
    """Print the table."""
    world, step = profile.microseconds("world"), profile.microseconds("step")
    parts = {
        "inside pymunk's Space.step": physics,
        "control law": world - physics,
        "reading poses and velocities": profile.microseconds("read"),
        "observation": profile.microseconds("show"),
        "copy for the caller": profile.microseconds("copy"),
    }
    parts["everything else"] = step - sum(parts.values())
    for name, microseconds in {**parts, "step": step}.items():
        print(f"{name:30} {microseconds:7.1f} us {microseconds / step:7.1%}")


if __name__ == "__main__":
    main()
