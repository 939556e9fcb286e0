"""Make a page of tables and figures from evaluated runs.

DIR is a folder that `magical evaluate POLICY --out DIR` has written, or a folder with such folders
at any depth. Folders with the same method are its runs and share a row.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from magical.commands import _common as common
from magical.evaluation.entry import policy_of
from magical.extras import require
from magical.report.found import find_results
from magical.report.table import (
    all_tables,
    format_of,
    matching_methods,
    plain_rows,
    rows_of,
    write_page,
    write_tables,
)

TITLE = "MAGICAL: results"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="folder with runs")
    meaning = (
        'rows of the published tables to show below, such as "BC (ST)" (default: those with the '
        "methods' names)"
    )
    common.add_several(parser, "--published", meaning, "METHOD")
    meaning = "title of the page (default: %(default)s)"
    parser.add_argument("--title", default=TITLE, help=meaning)
    meaning = "file to write the page to, or the tables in another --format"
    common.add_out(parser, meaning, "FILE")
    meaning = "format of FILE (default: by its suffix, .html, .csv or .md)"
    parser.add_argument("--format", choices=("html", "csv", "markdown"), help=meaning)
    meaning = (
        "show the best, median and worst rollouts of N runs, rerun with their policies "
        "(default: none)"
    )
    common.add_count(parser, "--clips", meaning)
    common.add_json(parser)


def run(args: argparse.Namespace) -> int:
    if args.format and not args.out:
        raise common.UsageError("--format needs --out FILE")
    kind = args.format or format_of(args.out) if args.out else None
    if args.clips and kind != "html":
        raise common.UsageError("--clips needs a page (--out FILE.html)")
    if kind == "html":
        require("report")
    found = find_results(args.folders)
    for item in found.skipped:
        common.log(f"skipped {item.folder}: {item.reason}")
    rows = rows_of(found.entries)
    published = tuple(matching_methods(found.entries) if args.published is None else args.published)
    for table in all_tables(rows, published):
        common.print_table(table.header, table.texts)
        print(f"{table.note}\n")
    notes: Sequence[str] = ()
    if kind == "html":
        notes = write_page(
            args.out,
            args.title,
            found,
            published,
            load_policy=lambda result: policy_of(result.folder, result.entry, result.run),
            clips=args.clips or 0,
        )
    elif kind:
        write_tables(kind, rows, published, args.out)
    if kind:
        common.log(f"wrote {args.out}")
    for note in notes:
        common.log(f"error: no rollouts of {note}")
    skipped = [{"folder": str(item.folder), "reason": item.reason} for item in found.skipped]
    common.print_json(args, {"rows": plain_rows(rows, published), "skipped": skipped})
    return int(bool(notes))
