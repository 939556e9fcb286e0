"""Go from nothing to a result: demonstrations, training, evaluation, and a page of results.

Scripted experts demonstrate MoveToRegion and MoveToCorner; behavioural cloning learns each from
pixels; its policies, the expert and a random policy are evaluated on all variants. This is
`magical run quickstart`, then `magical report`; an interrupted quickstart is continued.
"""

import argparse
from collections.abc import Mapping
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
    from magical.experiments.plan import Plan

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
    summary = execute(
        planned_runs(plan), args.out, resources, references=references, command=_command(args)
    )
    log(str(summary))
    if not summary.complete:
        return INTERRUPTED if summary.interrupted else 1
    return _report(args, plan)


def _command(args: argparse.Namespace) -> list[str]:
    """The words of this command, but for the folder."""
    options = {"--task": args.task, "--batches": args.batches and [args.batches]}
    options |= {"--seed": [args.seed], "--rollouts": [args.rollouts]}
    given = ([name, *map(str, values)] for name, values in options.items() if values)
    return ["quickstart", *(word for words in given for word in words)]


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
    scores = {name: _means(entries, name) for name in (learner, expert, random)}
    demo = {
        name: mean(of_one[task, DEMO] for task in plan.tasks) for name, of_one in scores.items()
    }
    lowest = []
    for task in plan.tasks:
        tests = [pair for pair in scores[learner] if pair[0] == task and pair[1] != DEMO]
        variant = min(tests, key=scores[learner].__getitem__)[1]
        score = scores[learner][task, variant]
        lowest.append(f"{score:.2f} on {task} {short_variant(variant)} ({CHANGED[variant]})")
    return [
        f"{learner}, trained on {plan.num_demos} demonstrations of {' and of '.join(plan.tasks)}, "
        f"scores {demo[learner]:.2f} in the scene of the demonstrations (Demo; the expert "
        f"{demo[expert]:.2f}, random actions {demo[random]:.2f}).",
        f"It fails most where it scores {' and '.join(lowest)}: where that is far below Demo, it "
        "has learned the scene rather than the task.",
    ]


def _means(entries: "list[Entry]", method: str) -> Mapping[tuple[str, str], float]:
    """A method's mean score by task and variant."""
    from magical.grouping import group_by

    rows = (row for entry in entries if entry.method == method for row in entry.scores)
    groups = group_by(rows, lambda row: (row.env_id.task, row.env_id.variant))
    return {pair: mean(row.score for row in group) for pair, group in groups.items()}
