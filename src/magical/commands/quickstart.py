"""From nothing to a result: demonstrations, training, evaluation, and a page that shows it.

Scripted experts demonstrate MoveToRegion and MoveToCorner; behavioural cloning learns each from
pixels; both policies are evaluated on all variants. An interrupted quickstart is continued.
"""

import argparse
from pathlib import Path

from magical.commands._common import log, non_negative_int, positive_int, print_table

HELP = "train, evaluate and report, from nothing"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/quickstart"),
        metavar="DIR",
        help="default: runs/quickstart",
    )
    parser.add_argument(
        "--task",
        action="append",
        metavar="TASK",
        help="may be repeated (default: MoveToRegion and MoveToCorner)",
    )
    parser.add_argument("--seed", metavar="N", type=non_negative_int, default=0, help="default: 0")
    parser.add_argument(
        "--rollouts",
        metavar="N",
        type=positive_int,
        default=100,
        help="on each variant (default: 100)",
    )
    parser.add_argument(
        "--batches", metavar="N", type=positive_int, help="of training (default: the preset's)"
    )
    parser.add_argument(
        "--workers", metavar="N", type=non_negative_int, help="processes (default: the cores)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the quickstart, print the tables, write the page."""
    from magical.experiments.quickstart import TASKS, Settings, Stopwatch, quickstart
    from magical.report import text_rows
    from magical.report.quickstart import quickstart_facts, quickstart_page, quickstart_tables

    settings = Settings(
        args.out,
        tasks=args.task or TASKS,
        seed=args.seed,
        rollouts=args.rollouts,
        batches=args.batches,
        workers=args.workers,
    )
    stopwatch = Stopwatch(log)
    result = quickstart(settings, stopwatch)
    tables = quickstart_tables(result.entries)
    path = settings.out / "report.html"
    facts = quickstart_facts(
        demos=settings.demos,
        rollouts=settings.rollouts,
        observation=result.policies[settings.tasks[0]].observation,
        seed=settings.seed,
        seconds=stopwatch.seconds,
    )
    with stopwatch.part("the page"):
        page = quickstart_page(
            settings.out,
            tables=tables,
            policies=result.policies,
            runs={task: settings.run_folder(task) for task in settings.tasks},
            rollouts=settings.rollouts,
            facts=facts,
        )
        page.write(path)
    for name, spent in stopwatch.seconds.items():
        log(f"{spent:6.0f} s  {name}")
    log(f"{sum(stopwatch.seconds.values()):6.0f} s  in all")
    for table in tables:
        print_table((table.task, *table.variants), text_rows(table))
        print(table.note)
        print()
    print(f"report: {path.resolve()}")
    return 0
