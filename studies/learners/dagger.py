"""DAgger beside behavioural cloning with as many labels of the same expert.

    python studies/learners/dagger.py --out runs/dagger
    python studies/learners/dagger.py --out runs/dagger-5 --task MatchRegions \
        --variants Demo Jitter Layout Colour Shape

Both learn from the same number of batches. DAgger begins with `--demos` demonstrations; BC gets as
many more as DAgger has episodes labelled, all of Demo. What is done already is kept in the folder
and not done again, so `--seeds 1` can be followed by `--seeds 3`.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from magical.demos.generate import generate
from magical.envs import EnvId
from magical.evaluation import environments, evaluate, summarise
from magical_baselines import Config, train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.dagger import DAggerConfig

Row = dict[str, Any]


def dagger(arguments: argparse.Namespace, task: str, seed: int) -> DAggerConfig:
    """DAgger with what was asked for in place of the preset's settings."""
    names = ("variants", "batches", "episodes", "network", "beta_decay")
    given = {name: getattr(arguments, name) for name in names}
    return DAggerConfig.preset(
        "quick",
        tasks=(task,),
        demos=str(arguments.out / "demos" / task),
        num_demos=arguments.demos,
        seed=seed,
        workers=arguments.workers,
        **{name: value for name, value in given.items() if value is not None},
    )


def bc(arguments: argparse.Namespace, task: str, seed: int) -> BCConfig:
    """Behavioural cloning of as many episodes, in as many batches, as DAgger."""
    other = dagger(arguments, task, seed)
    return BCConfig.preset(
        "quick",
        tasks=other.tasks,
        demos=other.demos,
        num_demos=other.num_demos + (other.rounds - 1) * other.episodes,
        seed=seed,
        network=other.network,
        batches=other.num_updates,
    )


METHODS: dict[str, Callable[[argparse.Namespace, str, int], Config]] = {"bc": bc, "dagger": dagger}


def measure(arguments: argparse.Namespace, method: str, task: str, seed: int) -> Row:
    """Train and evaluate once."""
    config = METHODS[method](arguments, task, seed)
    folder = arguments.out / f"{method}-{task}-{seed}"
    began = time.perf_counter()
    trained = train(config, folder, resume=folder.exists())
    took = time.perf_counter() - began
    scores = evaluate(
        trained.policy(),
        environments([task]),
        rollouts=arguments.rollouts,
        workers=arguments.workers,
    )
    means = {variant: cell["mean"] for variant, cell in summarise(scores).items()}
    return {
        "method": method,
        "task": task,
        "seed": seed,
        "rollouts": arguments.rollouts,
        "minutes": took / 60,
        "score": means,
    }


def rows(arguments: argparse.Namespace) -> Iterator[Row]:
    """Every result, those of earlier calls from the folder."""
    path = arguments.out / "results.jsonl"
    known = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    found = {(row["method"], row["task"], row["seed"], row["rollouts"]): row for row in known}
    for seed in range(arguments.seeds):
        for task in arguments.task:
            ensure_demos(arguments, task)
            for method in arguments.method:
                key = (method, task, seed, arguments.rollouts)
                if key not in found:
                    found[key] = measure(arguments, method, task, seed)
                    with path.open("a") as file:
                        file.write(json.dumps(found[key]) + "\n")
                yield found[key]


def ensure_demos(arguments: argparse.Namespace, task: str) -> None:
    """Demonstrations enough for all seeds' subsets."""
    folder = arguments.out / "demos" / task
    if not folder.exists():
        number = 2 * bc(arguments, task, 0).num_demos
        generate(str(EnvId(task, "Demo")), number, folder, workers=arguments.workers)


def say(row: Row) -> None:
    cells = "  ".join(f"{variant} {mean:.2f}" for variant, mean in row["score"].items())
    name = f"{row['task']} {row['method']} seed {row['seed']}"
    print(f"{name} ({row['minutes']:.1f} min): {cells}", flush=True)


def summary(found: list[Row]) -> None:
    """Mean and standard deviation over seeds, and the mean gap to Demo."""
    for task in dict.fromkeys(row["task"] for row in found):
        for method in dict.fromkeys(row["method"] for row in found):
            runs = [row["score"] for row in found if (row["task"], row["method"]) == (task, method)]
            table = np.array([list(scores.values()) for scores in runs])  # (seeds, variants)
            gaps = table[:, :1] - table[:, 1:]
            print(f"{task} {method}, {len(runs)} seeds, mean gap {gaps.mean():.3f}")
            for variant, column in zip(runs[0], table.T, strict=True):
                print(f"  {variant:10} {column.mean():.3f} +- {column.std():.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder for demonstrations, runs, results")
    add("--task", nargs="+", default=["MoveToCorner", "MatchRegions"], metavar="TASK")
    add("--method", nargs="+", choices=tuple(METHODS), default=list(METHODS))
    add("--seeds", type=int, default=3, help="runs of each method (default: 3)")
    add("--rollouts", type=int, default=20, help="on each variant (default: 20)")
    add("--demos", type=int, default=5, help="demonstrations that DAgger begins with (default: 5)")
    add("--variants", nargs="+", type=str, help="that DAgger's learner acts in (default: Demo)")
    add("--batches", type=int, help="in each round (default: the quick preset's, as for all below)")
    add("--episodes", type=int, help="in each round")
    add("--network", help="paper, narrow or light")
    add("--beta-decay", type=float)
    add("--workers", type=int, default=0, help="processes for the environments (default: none)")
    arguments = parser.parse_args()
    if arguments.variants:
        arguments.variants = tuple(arguments.variants)
    arguments.out.mkdir(parents=True, exist_ok=True)
    found = []
    for row in rows(arguments):
        say(row)
        found.append(row)
    summary(found)


if __name__ == "__main__":
    main()
