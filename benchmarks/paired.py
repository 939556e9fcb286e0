"""Compares the speed of two checkouts, taking turns in one process, in CPU time.

python benchmarks/paired.py BEFORE [AFTER] [--task NAME] [--seconds S]

BEFORE and AFTER are checkouts of this repository, AFTER by default this one. Both take the same
actions in the same scenes, and their simulations and observations must be equal to the last bit.
CPU time is least affected by other load.
"""

import argparse
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parents[1]
TURN = 20  # steps
EPISODE = 10  # turns
NUM_ACTIONS = 18


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path, nargs="?", default=HERE)
    parser.add_argument("--task", default="ClusterColour")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each comparison")
    arguments = parser.parse_args()
    trees = [Tree(path / "src", arguments.task) for path in (arguments.before, arguments.after)]
    for name in trees[0].starts:
        compare(name, trees, arguments.seconds)


class Tree:
    """The package in a folder.

    Attributes:
        starts: functions that map a seed to an object with `step(action)`, by name.
    """

    def __init__(self, source: Path, task_name: str) -> None:
        self._modules: dict[str, Any] = {}
        self.enter()
        sys.path.insert(0, str(source))
        envs, physics, tasks, scene = (
            import_module(f"magical.{room}") for room in ("envs.env", "physics", "tasks", "scene")
        )
        sys.path.pop(0)

        class Simulation(physics.Simulation):  # type: ignore[misc, name-defined]
            def step(self, action: int) -> Any:
                super().step(scene.to_continuous(action))
                return [self.read()]

        class Restarted(envs.MagicalEnv):  # type: ignore[misc, name-defined]
            def step(self, action: int) -> Any:
                return self.reset(seed=action)

        def simulate(seed: int) -> Any:
            return Simulation(*tasks.TASKS[task_name].sample("Demo", np.random.default_rng(seed)))

        def observe(observation: str) -> Callable[[int], Any]:
            env = envs.MagicalEnv(task_name, "Demo", observation=observation)

            def start(seed: int) -> Any:
                env.reset(seed=seed)
                return env

            return start

        self.starts = {
            "simulation": simulate,
            "state only": observe("state"),
            "with pixels": observe("LoRes4E"),
            "reset": lambda seed: Restarted(task_name, "TestAll", observation="LoRes4E"),
        }

    def enter(self) -> None:
        """Let imports find this tree's modules, also those within functions."""
        global current
        for name in [name for name in sys.modules if name.partition(".")[0] == "magical"]:
            current[name] = sys.modules.pop(name)
        current = self._modules
        sys.modules.update(current)


current: dict[str, Any] = {}  # the modules of the tree that was entered last


def compare(name: str, trees: list[Tree], seconds: float) -> None:
    """Step both sides in turns, and print microseconds per step and their ratio."""
    rng = np.random.default_rng(0)
    times: list[list[float]] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        running = []
        for tree in trees:
            tree.enter()
            running.append(one := tree.starts[name](len(times)))
            one.step(0)  # compiles
        for turn in range(EPISODE):
            actions = rng.integers(NUM_ACTIONS, size=TURN).tolist()
            spent = {}
            for side in (0, 1) if turn % 2 else (1, 0):
                trees[side].enter()
                spent[side] = step(running[side], actions)
            times.append([spent[side][0] for side in (0, 1)])
            assert np.array_equal(spent[0][1], spent[1][1]), "not equal"
    before, after = 1e6 / TURN * np.array(times).T
    low, middle, high = np.quantile(before / after, (0.25, 0.5, 0.75))
    print(
        f"{name:12} before {np.median(before):6.1f} us, after {np.median(after):6.1f} us, "
        f"ratio {middle:.2f} (quartiles {low:.2f} to {high:.2f}), {len(times)} turns"
    )


def step(side: Any, actions: list[int]) -> tuple[float, Any]:
    """The seconds that some steps take, and the last observation or state."""
    began = time.thread_time()
    for action in actions:
        result = side.step(action)
    spent = time.thread_time() - began
    return spent, side.read() if result is None else result[0]


if __name__ == "__main__":
    main()
