"""Make a page of tables from evaluated runs.

DIR is a folder that `magical evaluate POLICY --out DIR` has written; folders with the same method
are runs of it and share a row.
"""

import argparse
from pathlib import Path

from magical.commands._common import log, print_table

HELP = "make a page of tables from evaluated runs"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="evaluated runs")
    parser.add_argument(
        "--published",
        nargs="+",
        default=[],
        metavar="METHOD",
        help='rows of the published tables to show below, such as "BC (ST)"',
    )
    parser.add_argument("--title", default="MAGICAL: results")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page (HTML)")


def run(args: argparse.Namespace) -> int:
    """Read, tabulate, write."""
    from magical.evaluation import read_entry
    from magical.report import entry_tasks, task_table, text_rows
    from magical.report.aggregate import aggregate_header, aggregate_rows, aggregates

    entries = [read_entry(folder) for folder in args.folders]
    tables = [task_table(task, entries, args.published) for task in entry_tasks(entries)]
    for table in tables:
        print_table((table.task, *table.variants), text_rows(table))
        print(table.note)
        print()
    lines, note = aggregates(entries)
    if lines:
        print_table(aggregate_header(lines), aggregate_rows(lines))
        print(note)
    if args.out:
        from magical.report.folders import evaluated_page

        evaluated_page(args.title, args.folders, entries, tables).write(args.out)
        log(f"wrote {args.out}")
    return 0
