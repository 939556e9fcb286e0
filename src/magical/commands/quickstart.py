"""From nothing to a result: demonstrations, training, evaluation, and a page that shows it.

Scripted experts demonstrate MoveToRegion and MoveToCorner; behavioural cloning learns each from
pixels; both policies are evaluated on all variants. An interrupted quickstart is taken up again.
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
    parser.add_argument("--seed", type=non_negative_int, default=0, help="default: 0")
    parser.add_argument("--rollouts", type=positive_int, default=100, help="on each variant")
    parser.add_argument("--batches", type=positive_int, help="of training (default: the preset's)")
    parser.add_argument("--workers", type=non_negative_int, help="processes (default: the cores)")


def run(args: argparse.Namespace) -> int:
    """Run, print the tables, say where the page is."""
    from magical.report import text_rows
    from magical.report.quickstart import TASKS, Settings, quickstart

    settings = Settings(
        args.out,
        tasks=args.task or TASKS,
        seed=args.seed,
        rollouts=args.rollouts,
        batches=args.batches,
        workers=args.workers,
    )
    tables, page = quickstart(settings, log)
    for table in tables:
        print_table((table.task, *table.variants), text_rows(table))
        print(table.note)
        print()
    print(f"report: {page.resolve()}")
    return 0
