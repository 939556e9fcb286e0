"""Train a plan's runs of GAIL, WGAIL-GP or AL, and score Layout while they train.

python -m studies.demonstrations.layout PLAN --demos DIR [--out DIR] [--every 50000]
    [--task TASK ...] [--rollouts 100]

PLAN is a plan's file. Each run is trained in its folder of the plan's results, where
`magical run` finds it done and evaluates it; after every so many environment steps its policy is
scored on Layout, by the published code's rule, and the mean is added to `layout.csv` in the folder.
The command continues what was interrupted. At the end the curves are printed, as STEPS:MEAN.
"""

import argparse
import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from magical.evaluation import environments, load_policy
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import roll_out
from magical.plugins import import_user_module
from magical.runs import is_run
from magical.runs.folder import CHECKPOINT
from magical.runs.plan import RUNS
from magical_baselines import train
from magical_baselines.algorithms.ppo import ReinforcementConfig
from magical_baselines.checkpoints import load_checkpoint
from magical_baselines.compute import cpu_threads
from magical_baselines.experiments.execution import opened
from magical_baselines.experiments.plan import PlannedRun, planned_runs, read_plan

CURVE = "layout.csv"  # in a run's folder: environment steps, mean score


def follow(run: PlannedRun, folder: Path, demos: Path, evaluation: Evaluation, every: int) -> None:
    """Train a run in stages, or what is left of it, and score it after each."""
    config = run.config.replace(demos=str(demos))
    if not isinstance(config, ReinforcementConfig):
        raise SystemExit(f"{run}: {run.config.algorithm} takes no environment steps")
    each, total = config.steps_per_update, config.num_updates
    while (step := read_step(folder)) < total:
        stage = max(1, every // each)
        left = min(stage - step % stage, total - step)
        if train(config, folder, resume=is_run(folder), stop_after=left).interrupted:
            raise SystemExit(f"{folder}: interrupted; the same command continues")
        with cpu_threads(run.config.threads or 1):
            scores = roll_out(load_policy(folder), evaluation, workers=0)
        mean = sum(row.published_code_score for row in scores) / len(scores)
        with (folder / CURVE).open("a", newline="") as file:
            csv.writer(file).writerow((read_step(folder) * each, f"{mean:.4f}"))


def read_step(folder: Path) -> int:
    """How many updates a run's newest checkpoint has; 0 without one."""
    if not (folder / CHECKPOINT).exists():
        return 0
    return int(load_checkpoint(folder / CHECKPOINT)["step"])


def read_curve(folder: Path) -> list[tuple[int, float]]:
    """Environment steps and mean scores of a run; empty before the first."""
    if not (folder / CURVE).exists():
        return []
    with (folder / CURVE).open(newline="") as file:
        return [(int(steps), float(mean)) for steps, mean in csv.reader(file)]


def main(arguments: Sequence[str] | None = None) -> None:
    assert __doc__
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("plan", type=Path, metavar="PLAN")
    parser.add_argument("--demos", type=Path, required=True, metavar="DIR")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: runs/PLAN")
    parser.add_argument("--every", type=int, default=50_000, metavar="STEPS", help="default: 50000")
    parser.add_argument("--task", nargs="+", default=[], help="default: the plan's")
    parser.add_argument("--rollouts", type=int, default=100, help="default: 100")
    parser.add_argument(
        "--import", dest="imports", nargs="+", default=[], help="modules that the plan names"
    )
    args = parser.parse_args(arguments)
    for module in args.imports:
        import_user_module(module)
    out = args.out or Path("runs", args.plan.stem)
    runs = planned_runs(read_plan(args.plan))
    with opened(out):
        for run in runs:
            if not args.task or set(run.tasks) <= set(args.task):
                env_ids = tuple(environments(run.tasks, ["Layout"]))
                evaluation = replace(run.evaluation, env_ids=env_ids, rollouts=args.rollouts)
                follow(run, out / RUNS / run.folder, args.demos, evaluation, args.every)
    for run in runs:
        curve = read_curve(out / RUNS / run.folder)
        print(f"{run}: {' '.join(f'{at}:{mean:.2f}' for at, mean in curve) or 'not run'}")


if __name__ == "__main__":
    main()
