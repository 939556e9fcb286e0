"""Run a plan: train and evaluate every method on every task with every seed.

PLAN is a TOML file (docs/experiments.md), or the name of one of this package's plans: `quick`,
`quickstart`, or `paper` for the appendix's whole grid. The same command continues an interrupted
plan: finished runs are not repeated, and interrupted ones resume from their last checkpoint.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
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

UPDATES = 6  # of each method, to estimate times; the first is not counted
UNITS = (("day", 86_400.0), ("hour", 3_600.0), ("minute", 60.0), ("second", 1.0))
HELP = "run a plan of training runs, on this machine or a Ray cluster"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    meaning = "a plan of this package, such as quick, or a TOML file"
    parser.add_argument("plan", metavar="PLAN", help=meaning)
    add_out(parser, "results folder (default: runs/NAME, with the plan's name)")
    meaning = "a dataset of demonstrations, or `expert`, instead of the plan's"
    parser.add_argument("--demos", metavar="FOLDER", help=meaning)
    meaning = "where to run: in processes on this machine, or as tasks of a Ray cluster"
    parser.add_argument("--executor", choices=("local", "ray"), default="local", help=meaning)
    meaning = "address of a Ray cluster (default: this machine's, or a new one)"
    parser.add_argument("--address", metavar="ADDRESS", help=f"{meaning}; implies --executor ray")
    meaning = "runs at a time on this machine (default: number of cores / threads per run)"
    add_count(parser, "--workers", meaning)
    add_number(parser, "--gpus", "share of a GPU that Ray reserves for each run")
    meaning = "list the runs with their state, and estimate the time of training; run nothing"
    parser.add_argument("--dry-run", action="store_true", help=meaning)
    parser.add_argument("--retry-failed", action="store_true", help="rerun failed runs")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Execute the plan, or describe what it would do."""
    from magical_baselines.experiments import plan as plans

    on_cluster = args.address or args.executor == "ray"
    if args.gpus and not on_cluster:
        raise UsageError("--gpus needs --executor ray")
    path = plans.find_plan(args.plan)
    plan = plans.read_plan(path, args.demos)
    runs, out = plans.planned_runs(plan), args.out or Path("runs") / path.stem
    if args.dry_run:
        return _dry_run(args, runs, out)
    from magical.processes import available_cores
    from magical_baselines.experiments.execution import Processes, execute
    from magical_baselines.experiments.status import read_status

    if on_cluster:
        from magical_baselines.experiments.cluster import RayTasks  # an optional library

        cores = args.workers and args.workers * plan.threads
        executor: Processes | RayTasks = RayTasks(out, args.address, cores, args.gpus)
    else:
        executor = Processes(runs, args.workers)
    interrupted = execute(
        runs,
        out,
        executor,
        references=plans.planned_references(plan),
        workers=args.workers or available_cores(),
        retry_failed=args.retry_failed,
        command=["run", args.plan, *(["--demos", args.demos] if args.demos else [])],
    )
    status = read_status(out)
    log(str(status))
    print_json(args, {**status.to_dict(), "interrupted": interrupted})
    return INTERRUPTED if interrupted else int(not status.complete)


def _dry_run(args: argparse.Namespace, runs: "Sequence[PlannedRun]", out: Path) -> int:
    from magical_baselines.experiments.execution import planned_state

    states = [planned_state(run, out) or "waiting" for run in runs]
    print_table(("run", "state"), list(zip(runs, states, strict=True)))
    kept = ("done",) if args.retry_failed else ("done", "failed")
    left = [run for run, state in zip(runs, states, strict=True) if state not in kept]
    seconds = training_seconds(left)
    words = f"; training takes {in_words(seconds)} here, one run at a time" if left else ""
    print(f"{out}: {len(left)} of {len(runs)} runs to do{words}")
    plan = [{"run": run.folder, "state": state} for run, state in zip(runs, states, strict=True)]
    print_json(args, {"out": str(out), "runs": len(runs), "plan": plan, "seconds": round(seconds)})
    return 0


def training_seconds(runs: "Sequence[PlannedRun]") -> float:
    """The seconds of training the runs one after another here; raises what training does."""
    first = {run.method: run for run in reversed(runs)}
    with TemporaryDirectory() as name:
        each = {method: _update_seconds(run, Path(name)) for method, run in first.items()}
    return sum(each[run.method] * run.config.num_updates for run in runs)


def _update_seconds(run: "PlannedRun", folder: Path) -> float:
    """The time of an update, measured on the run's first task."""
    from magical_baselines import train
    from magical_baselines.experiments.execution import prepare_demonstrations

    config = run.config.replace(tasks=run.tasks[:1])
    wanted = config.to_dict()
    source = replace(run.source, expert_demos=run.source.expert_demos and wanted["num_demos"])
    demos = prepare_demonstrations([replace(run, config=config, source=source)], folder)
    settings = {"demos": str(demos), "log_every": 1}
    config = config.replace(**{name: settings[name] for name in settings if name in wanted})
    times: list[float] = []
    note = lambda step, metrics: times.append(time.perf_counter())  # noqa: E731
    train(config, folder / run.folder, stop_after=UPDATES, callback=note)
    return (times[-1] - times[0]) / max(1, len(times) - 1)


def in_words(seconds: float) -> str:
    """A duration as a person would say it, such as `about 3 hours`."""
    name, size = next(unit for unit in UNITS if seconds >= 1.5 * unit[1] or unit[1] == 1)
    number = round(seconds / size, -1 if seconds > 20 * size else None)
    return f"about {number:,.0f} {name}{'s' * (number != 1)}"
