"""Go from nothing to a result: demonstrations, training, evaluation, and a page of results.

Scripted experts demonstrate MoveToRegion and MoveToCorner; behavioural cloning learns each from
pixels; its policies, the expert and a random policy are evaluated on all variants. This is
`magical run quickstart`, then `magical report`; an interrupted quickstart is continued.
"""

import argparse
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING

from magical.commands._common import (
    INTERRUPTED,
    add_count,
    add_json,
    add_out,
    add_rollouts,
    add_seed,
    add_tasks,
    log,
    print_json,
)

if TYPE_CHECKING:
    from magical.evaluation import Entry
    from magical_baselines.experiments.plan import Plan

PUBLISHED = ["BC (ST)"]  # the row of the published tables that the scores are shown beside
HELP = "train, evaluate and report, from scratch"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    add_out(parser, "results folder (default: runs/quickstart)")
    parser.set_defaults(out=Path("runs/quickstart"))
    add_tasks(parser, "MoveToRegion and MoveToCorner")
    add_seed(parser, "training seed")
    add_rollouts(parser)
    add_count(parser, "--batches", "training batches (default: 2000)")
    add_count(parser, "--workers", "runs at a time (default: one per core)")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Execute the plan, write the page, say in three sentences what came of it."""
    from magical.processes import available_cores
    from magical_baselines.experiments import plan as plans
    from magical_baselines.experiments.execution import Processes, execute
    from magical_baselines.experiments.status import read_status

    plan = plans.read_plan(plans.find_plan("quickstart"))
    (method,) = plan.methods
    if args.batches:
        method = replace(method, settings={"batches": args.batches})
    tasks = tuple(args.task or plan.tasks)
    plan = replace(plan, methods=(method,), tasks=tasks, seeds=(args.seed,), rollouts=args.rollouts)
    command = ["quickstart", "--task", *tasks, "--seed", args.seed, "--rollouts", args.rollouts]
    command += ["--batches", args.batches] if args.batches else []
    runs = plans.planned_runs(plan)
    interrupted = execute(
        runs,
        args.out,
        Processes(runs, args.workers),
        references=plans.planned_references(plan),
        workers=args.workers or available_cores(),
        command=list(map(str, command)),
    )
    status = read_status(args.out)
    log(str(status))
    if not status.complete:
        return INTERRUPTED if interrupted else 1
    return _report(args, plan)


def _report(args: argparse.Namespace, plan: "Plan") -> int:
    from magical.evaluation.loading import policy_of
    from magical.report.found import find_results
    from magical.report.page import plain_rows, write_page
    from magical.report.table import rows_of

    found = find_results([args.out])
    conclusions, page = _conclusions(plan, found.entries), args.out / "report.html"
    notes = write_page(
        page,
        "MAGICAL quickstart",
        found,
        PUBLISHED,
        load_policy=lambda result: policy_of(result.folder, result.entry, result.run),
        clips=len(plan.tasks) * (len(plan.methods) + len(plan.references)),
        conclusions=conclusions,
    )
    for note in notes:
        log(f"error: no rollouts of {note}")
    for sentence in conclusions:
        print(sentence)
    print(f"{page.resolve()} shows all scores beside the published ones, and what the policies do.")
    skipped = [{"folder": str(s.folder), "reason": s.reason} for s in found.skipped]
    print_json(args, {"rows": plain_rows(rows_of(found.entries), PUBLISHED), "skipped": skipped})
    return int(bool(notes))


def _conclusions(plan: "Plan", entries: "list[Entry]") -> list[str]:
    """What was learned, and where it fails, in a sentence each."""
    from magical.tasks.axes import CHANGED, DEMO, short_variant

    (learner, *_), (expert, random) = (method.name for method in plan.methods), plan.references
    scores: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for entry in entries:
        for row in entry.scores:
            scores[entry.method, row.env_id.task, row.env_id.variant].append(row.score)
    means = {key: mean(found) for key, found in scores.items()}
    demo = {
        name: mean(means[name, task, DEMO] for task in plan.tasks)
        for name in (learner, expert, random)
    }
    lowest = []
    for task in plan.tasks:
        tests = [key for key in means if key[:2] == (learner, task) and key[2] != DEMO]
        worst = min(tests, key=means.__getitem__)
        where = f"{task} {short_variant(worst[2])} ({CHANGED[worst[2]]})"
        lowest.append(f"{means[worst]:.2f} on {where}")
    return [
        f"{learner}, trained on {plan.num_demos} demonstrations of {' and of '.join(plan.tasks)}, "
        f"scores {demo[learner]:.2f} in the scene of the demonstrations (Demo; the expert "
        f"{demo[expert]:.2f}, random actions {demo[random]:.2f}).",
        f"It fails most where it scores {' and '.join(lowest)}: where that is far below Demo, it "
        "has learned the scene rather than the task.",
    ]
