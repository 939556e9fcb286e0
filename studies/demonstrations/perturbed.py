"""Behavioural cloning of perturbed demonstrations beside that of plain ones, as many of each.

    python studies/demonstrations/perturbed.py --out runs/perturbed
    python studies/demonstrations/perturbed.py --out runs/choice --task MoveToCorner --seeds 0 \
        --perturb 0 0.1 0.2 0.3 --variants Demo Jitter

A run has its own demonstrations, whose seed is the run's, all with a score of 1. Finished runs and
evaluations are kept in the folder and are not repeated; an interrupted run is resumed.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from magical.demos import Dataset
from magical.demos.generate import generate
from magical.envs import EnvId
from magical.evaluation import RolloutScore, environments, evaluate, read_scores, write_scores
from magical.evaluation.statistics import Interval, difference, mean, run_means
from magical.learning import train
from magical.learning.algorithms.bc import BCConfig
from magical.tasks.axes import short_variant

TASKS = ("MoveToRegion", "MoveToCorner", "MatchRegions", "FixColour")


def run(arguments: argparse.Namespace, task: str, share: float, seed: int) -> list[RolloutScore]:
    """The scores of one training run, from its file where there is one."""
    folder = arguments.out / f"{task}-{share:g}-{seed}"
    file = folder / f"scores-{'-'.join(arguments.variants or ['all'])}-{arguments.rollouts}.csv"
    if file.exists():
        return read_scores(file)
    demos, out = folder / "demos", folder / "run"
    env_id = EnvId(task, "Demo")
    missing = arguments.demos - (len(Dataset.open(demos)) if demos.exists() else 0)
    if missing == arguments.demos:
        workers = max(arguments.workers, 1)
        generate(env_id, missing, demos, seed=seed, perturb=share, min_score=1.0, workers=workers)
    elif missing:
        raise SystemExit(f"{demos}: expected {arguments.demos} demonstrations; remove it")
    config = BCConfig.preset(
        "quick", tasks=(task,), demos=str(demos), num_demos=arguments.demos, seed=seed, threads=1
    )
    policy = train(config, out, resume=out.exists(), progress=True).policy()
    scores = evaluate(
        policy,
        environments([task], arguments.variants),
        rollouts=arguments.rollouts,
        workers=arguments.workers,
    )
    write_scores(scores, file)
    return scores


def show(title: str, found: dict[float, list[list[RolloutScore]]], env_ids: list[EnvId]) -> None:
    """Print the mean of each share, and its difference to the first, with intervals over runs."""
    tables = {share: run_means(runs, env_ids) for share, runs in found.items()}
    first = next(iter(tables.values()))
    for share, table in tables.items():
        text = f"{title:26} P = {share:<4g} {_text(mean(table))}"
        if table is not first:
            text += f"  difference {_text(difference(table, first))}"
        print(text)


def _text(interval: Interval) -> str:
    return f"{interval.value:+.3f} [{interval.low:+.3f}, {interval.high:+.3f}]"


def report(tasks: Sequence[str], found: dict[tuple[str, float], list[list[RolloutScore]]]) -> None:
    """Print the results by environment, by task, and over all."""
    shares = list(dict.fromkeys(share for _, share in found))
    everything: list[EnvId] = []
    for task in tasks:
        of_task = {share: found[task, share] for share in shares}
        env_ids = list(dict.fromkeys(row.env_id for row in of_task[shares[0]][0]))
        for env_id in env_ids:
            show(f"{task} {short_variant(env_id.variant)}", of_task, [env_id])
        show(f"{task}, all variants", of_task, env_ids)
        everything += env_ids
    merged = {share: [run for task in tasks for run in found[task, share]] for share in shares}
    show("all tasks", merged, everything)


def describe(arguments: argparse.Namespace, task: str, share: float) -> None:
    """Print how often the demonstrations' actions are others than the expert's."""
    folders = [arguments.out / f"{task}-{share:g}-{seed}" / "demos" for seed in arguments.seeds]
    differ = [t.labels != t.actions for folder in folders for t in Dataset.open(folder)]
    print(f"{task}, P = {share:g}: {np.concatenate(differ).mean():.3f} of the steps perturbed")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder for demonstrations, runs, scores")
    add("--task", nargs="+", default=list(TASKS), metavar="TASK")
    add("--perturb", nargs="+", type=float, default=[0.0, 0.2], metavar="P", help="0 0.2")
    add("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="S", help="0 1 2")
    add("--variants", nargs="+", metavar="VARIANT", help="to evaluate on (default: all)")
    add("--demos", type=int, default=25, help="demonstrations of each run (default: 25)")
    add("--rollouts", type=int, default=100, help="on each variant (default: 100)")
    add("--workers", type=int, default=0, help="processes for the environments (default: none)")
    arguments = parser.parse_args()
    found: dict[tuple[str, float], list[list[RolloutScore]]] = {}
    for seed in arguments.seeds:
        for task in arguments.task:
            for share in arguments.perturb:
                scores = run(arguments, task, share, seed)
                found.setdefault((task, share), []).append(scores)
    for task in arguments.task:
        for share in arguments.perturb:
            describe(arguments, task, share)
    report(arguments.task, found)


if __name__ == "__main__":
    main()
