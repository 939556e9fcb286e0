"""Run a plan: train and evaluate every method on every task with every seed.

PLAN is a TOML file (docs/experiments.md), or the name of one of this package's plans: `quick`,
`quickstart`, or `paper` for the appendix's whole grid. The same command continues an interrupted
plan: finished runs are not repeated, and interrupted ones resume from their last checkpoint.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import (
    INTERRUPTED,
    UsageError,
    add_count,
    add_json,
    add_number,
    add_out,
    log,
    print_json,
    print_table,
)

if TYPE_CHECKING:
    from magical_baselines.experiments.plan import PlannedRun

HELP = "run a plan of training runs, on this machine or a Ray cluster"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "plan", metavar="PLAN", help="a plan of this package, such as quick, or a TOML file"
    )
    add_out(parser, "results folder (default: runs/NAME, with the plan's name)")
    parser.add_argument(
        "--demos",
        metavar="FOLDER",
        help="a dataset of demonstrations, or `expert`, instead of the plan's",
    )
    parser.add_argument(
        "--executor",
        choices=("local", "ray"),
        default="local",
        help="where to run: in processes on this machine, or as tasks of a Ray cluster",
    )
    parser.add_argument(
        "--address",
        metavar="ADDRESS",
        help="address of a Ray cluster, as for ray.init; implies --executor ray (default: the "
        "cluster that this machine belongs to, or a new one)",
    )
    meaning = "runs at a time on this machine (default: number of cores / threads per run)"
    add_count(parser, "--workers", meaning)
    add_number(parser, "--gpus", "share of a GPU that Ray reserves for each run")
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="list the runs with their estimated time and state, without running any",
    )
    parser.add_argument("--retry-failed", action="store_true", help="rerun failed runs")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Execute the plan, or describe what it would do."""
    from magical_baselines.experiments.plan import (
        find_plan,
        planned_references,
        planned_runs,
        read_plan,
    )

    if args.gpus and not (args.address or args.executor == "ray"):
        raise UsageError("--gpus needs --executor ray")
    path = find_plan(args.plan)
    plan = read_plan(path, args.demos)
    out = args.out or Path("runs") / path.stem
    if args.dry_run:
        return _dry_run(args, planned_runs(plan), out)
    from magical_baselines.experiments.execution import Resources, execute  # imports PyTorch

    resources = Resources(
        executor="ray" if args.address else args.executor,
        address=args.address,
        workers=args.workers,
        gpus=args.gpus,
    )
    summary = execute(
        planned_runs(plan),
        out,
        resources,
        references=planned_references(plan),
        retry_failed=args.retry_failed,
        command=["run", args.plan, *(["--demos", args.demos] if args.demos else [])],
    )
    log(str(summary))
    print_json(args, summary.to_dict())
    if summary.interrupted:
        return INTERRUPTED
    return 0 if summary.complete else 1


def _dry_run(args: argparse.Namespace, runs: "Sequence[PlannedRun]", out: Path) -> int:
    from magical_baselines.experiments.forecast import HEADER, forecast

    expected = forecast(runs, out, retry_failed=args.retry_failed)
    print_table(HEADER, expected.rows())
    for line in expected.lines():
        print(line)
    print_json(args, expected.to_dict())
    return 0
