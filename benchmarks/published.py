"""Compares the speed of the environments with that of the published ones, by turns.

xvfb-run -a python benchmarks/published.py --published-python PATH [--turns N]

PATH is the Python of an environment that has the published package, magical-il. Its dependencies
(gym 0.17, pymunk 5.6, pyglet 1.5) install with Python 3.8; its renderer needs OpenGL and a display,
which Xvfb and Mesa provide (on Debian: apt install xvfb libgl1-mesa-dri libglu1-mesa):

    python3.8 -m venv published
    published/bin/python -m pip install magical-il
    xvfb-run -a python benchmarks/published.py --published-python published/bin/python

In a turn both take random actions for whole episodes of the published length, resets included: the
published environment for one, this package's for `EPISODES`. Rates vary with other load on the
machine; ratios of neighbouring turns, and of processor time, less so.
"""

import argparse
import subprocess
import time

import gymnasium
import numpy as np

import magical

TASKS = ("ClusterColour-Demo", "MoveToCorner-Demo", "MatchRegions-TestAll")
EPISODES = 20  # of this package in a turn
# What the published package's Python runs: for every id on standard input, an episode, and a line
# with its steps and the seconds of elapsed and of processor time.
PUBLISHED = """
import random, sys, time
import gym, magical
magical.register_envs()
envs = {}
for line in sys.stdin:
    name = line.strip()
    if name not in envs:
        envs[name] = gym.make(name)
        envs[name].seed(0)
        envs[name].reset()
    env = envs[name]
    steps, done, began = 0, False, (time.perf_counter(), time.process_time())
    env.reset()
    while not done:
        done = env.step(random.randrange(18))[2]
        steps += 1
    spent = time.perf_counter() - began[0], time.process_time() - began[1]
    print("turn", steps, *spent, flush=True)
"""


class Ours:
    """This package's environment, with the published horizon."""

    def __init__(self, name: str) -> None:
        assert magical.__version__  # importing the package registered its environments
        self._env = gymnasium.make(f"magical/{name}", horizon="published")
        self._env.reset(seed=0)
        self._env.action_space.seed(0)
        self._env.step(0)  # compiles

    def turn(self) -> tuple[float, float]:
        """Microseconds of elapsed and of processor time for each step of some episodes."""
        steps, began = 0, (time.perf_counter(), time.process_time())
        for _ in range(EPISODES):
            self._env.reset()
            truncated = False
            while not truncated:
                truncated = self._env.step(self._env.action_space.sample())[3]
                steps += 1
        spent = time.perf_counter() - began[0], time.process_time() - began[1]
        return 1e6 * spent[0] / steps, 1e6 * spent[1] / steps


class Published:
    """The published package, in a process of its own."""

    def __init__(self, python: str) -> None:
        pipe = subprocess.PIPE
        command = [python, "-I", "-W", "ignore", "-c", PUBLISHED]
        self._child = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)

    def turn(self, name: str) -> tuple[float, float]:
        """Microseconds of elapsed and of processor time for each step of an episode."""
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        print(name, file=self._child.stdin, flush=True)
        for line in self._child.stdout:
            word, *numbers = line.split()
            if word == "turn":
                steps, elapsed, processor = map(float, numbers)
                return 1e6 * elapsed / steps, 1e6 * processor / steps
        raise SystemExit("the published package's process ended: see its message above")

    def close(self) -> None:
        self._child.kill()
        self._child.wait()


def compare(published: Published, name: str, turns: int) -> None:
    """Print steps per second of both, and the median and quartiles of their ratio over turns."""
    ours = Ours(name)
    times = []
    for turn in range(turns + 1):
        if turn % 2:
            theirs, own = published.turn(name), ours.turn()
        else:
            own, theirs = ours.turn(), published.turn(name)
        times.append((theirs, own))
    both = np.array(times[1:])  # (turns, 2 packages, 2 clocks); the first turn warms up
    print(f"{name}, {turns} turns:")
    for clock, spent in zip(("elapsed", "processor"), np.moveaxis(both, 2, 0), strict=True):
        low, middle, high = np.quantile(spent[:, 0] / spent[:, 1], (0.25, 0.5, 0.75))
        before, after = 1e6 / np.median(spent, axis=0)
        print(
            f"  {clock:9} time: published {before:5.0f} steps/s, here {after:6.0f}, "
            f"ratio {middle:.0f} (quartiles {low:.0f} to {high:.0f})"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--published-python", required=True, metavar="PATH")
    parser.add_argument("--turns", type=int, default=20)
    arguments = parser.parse_args()
    published = Published(arguments.published_python)
    try:
        for task in TASKS:
            compare(published, f"{task}-LoRes4E-v0", arguments.turns)
    finally:
        published.close()


if __name__ == "__main__":
    main()
