"""Checks that behavioural cloning learns: MoveToRegion's Demo with `quick`, at least 0.9.

python benchmarks/learns.py

From 25 scripted demonstrations, seed 0, 100 rollouts; about two minutes on two cores. The exit
status is 1 if the score is lower. It runs every night.
"""

import sys
import tempfile
from pathlib import Path

from magical.demos.generate import generate
from magical.evaluation import environments, evaluate, summarise
from magical_baselines import train
from magical_baselines.algorithms.bc import BCConfig

LEAST = 0.9


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        demos = Path(folder) / "demos"
        generate("magical/MoveToRegion-Demo-v0", 25, demos, workers=1)
        config = BCConfig.preset(
            "quick", tasks=("MoveToRegion",), demos=str(demos), num_demos=25, seed=0
        )
        policy = train(config, Path(folder) / "run").policy()
        scores = evaluate(policy, environments(["MoveToRegion"], ["Demo"]), rollouts=100)
    score = summarise(scores)["Demo"]["mean"]
    print(f"BC quick, MoveToRegion, Demo: {score:.2f}, expected at least {LEAST}")
    return int(score < LEAST)


if __name__ == "__main__":
    sys.exit(main())
