"""Prints speeds as ratios to a fixed workload, so that machines and days can be compared.

python benchmarks/regression.py [--rounds N]

The workload is a fixed number of NumPy calls on small arrays, which take their time in the
interpreter and in compiled code, as environments do. Each measurement and the workload take turns;
a ratio is the median over rounds of (workload's processor time / measurement's), so higher is
faster. CI prints the table; compare it with that of an earlier commit.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np

from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import environments, evaluate

ENV_ID, STEPS = "magical/ClusterColour-Demo-LoRes4E-v0", 200


def workload() -> None:
    """About as long as 200 control steps with pixels."""
    array = np.arange(64.0)
    for _ in range(8000):
        array = np.sqrt(array * array + 1.0) - 0.5


def measurements() -> dict[str, Callable[[], object]]:
    env = MagicalEnv("ClusterColour", "Demo", observation="LoRes4E")
    state = MagicalEnv("ClusterColour", "Demo", observation="state")
    envs = MagicalVectorEnv([ENV_ID] * 8, workers=1)
    actions = np.random.default_rng(0).integers(18, size=STEPS)
    envs.reset(seed=0)

    def steps(which: MagicalEnv) -> None:
        which.reset(seed=0)
        for action in actions.tolist():
            which.step(action)

    def vector() -> None:
        for action in actions[: STEPS // 8]:
            envs.step(np.full(8, action))

    def resets() -> None:
        for seed in range(50):
            env.reset(seed=seed)

    ids = environments(["MoveToRegion"], ["Demo"])
    return {
        f"{STEPS} steps with pixels": lambda: steps(env),
        f"{STEPS} steps with the state vector": lambda: steps(state),
        f"{STEPS} steps in a vector of 8": vector,
        "50 resets with pixels": resets,
        "10 rollouts of the expert on MoveToRegion": lambda: evaluate(
            "expert", ids, rollouts=10, workers=0
        ),
    }


def timed(function: Callable[[], object]) -> float:
    """Processor time, seconds."""
    start = time.process_time()
    function()
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    for name, measured in measurements().items():
        measured()  # compiles, and warms up
        pairs = [(timed(workload), timed(measured)) for _ in range(args.rounds)]
        print(f"{name:44} {statistics.median(base / own for base, own in pairs):6.2f}")


if __name__ == "__main__":
    main()
