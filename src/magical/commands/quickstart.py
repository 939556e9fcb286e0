"""Go from nothing to a result: demonstrations, training, evaluation, and a page of results.

Scripted experts demonstrate MoveToRegion and MoveToCorner; behavioural cloning learns each from
pixels; its policies, the expert and a random policy are evaluated on all variants. This is
`magical run quickstart`, then `magical report`; an interrupted quickstart is continued.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from magical.commands import report
from magical.commands._common import (
    INTERRUPTED,
    add_count,
    add_json,
    add_out,
    add_rollouts,
    add_seed,
    add_tasks,
    log,
)

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
    """Execute the plan, print the tables, write the page."""
    from magical.experiments.execution import Resources, execute
    from magical.experiments.plan import find_plan, planned_references, planned_runs, read_plan
    from magical.extras import require

    require("report")
    plan = read_plan(find_plan("quickstart"))
    if args.batches:
        settings = {"batches": args.batches}
        methods = tuple(replace(method, settings=settings) for method in plan.methods)
        plan = replace(plan, methods=methods)
    plan = replace(
        plan,
        tasks=tuple(args.task or plan.tasks),
        seeds=(args.seed,),
        rollouts=args.rollouts,
    )
    references = planned_references(plan)
    resources = Resources(workers=args.workers)
    summary = execute(planned_runs(plan), args.out, resources, references=references)
    log(str(summary))
    if not summary.complete:
        return INTERRUPTED if summary.interrupted else 1
    page = argparse.Namespace(
        folders=[args.out],
        published=["BC (ST)"],
        title="MAGICAL quickstart",
        out=args.out / "report.html",
        format="html",
        compare=None,
        json=args.json,
        clips=len(plan.tasks) * (len(plan.methods) + len(plan.references)),
    )
    status = report.run(page)
    log(f"report: {page.out.resolve()}")
    return status
