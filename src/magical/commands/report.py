"""Make a page of tables and figures from evaluated runs.

DIR is a folder that `magical evaluate POLICY --out DIR` has written, or a folder with such folders
at any depth. Folders with the same method are its runs and share a row.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magical.commands._common import (
    UsageError,
    add_count,
    add_json,
    add_out,
    add_several,
    log,
    plain_interval,
    print_json,
    print_table,
)

if TYPE_CHECKING:
    from magical.report.found.search import Found
    from magical.report.scores.tables import TextTable

HELP = "make a page of tables from evaluated runs"
TITLE = "MAGICAL: results"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="folder with runs")
    meaning = (
        'rows of the published tables to show below, such as "BC (ST)" (default: those with the '
        "methods' names)"
    )
    add_several(parser, "--published", meaning, "METHOD")
    parser.add_argument("--title", help=f"title of the page (default: {TITLE})")
    add_out(parser, "file to write the page to, or the tables in another --format", "FILE")
    parser.add_argument(
        "--format",
        choices=("html", "csv", "markdown", "latex"),
        help="format of FILE (default: by its suffix, .html, .csv, .md or .tex)",
    )
    parser.add_argument(
        "--compare",
        nargs=2,
        metavar=("A", "B"),
        help="show the difference between two methods instead",
    )
    add_count(
        parser,
        "--clips",
        "show the best, median and worst rollouts of N runs, rerun with their policies "
        "(default: none)",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Read, tabulate, write."""
    from magical.extras import require
    from magical.report.found.search import find_results
    from magical.report.pages.export import format_of

    if args.format and not args.out:
        raise UsageError("--format needs --out FILE")
    kind = args.format or format_of(args.out) if args.out else None
    if args.compare and kind not in (None, "html"):
        raise UsageError("--compare writes HTML only; use --out FILE.html")
    if args.compare and (args.title or args.published is not None):
        raise UsageError("--compare excludes --title and --published")
    if args.clips and (args.compare or kind != "html"):
        raise UsageError("--clips needs a page (--out FILE.html), and excludes --compare")
    if kind == "html":
        require("report")
    found = find_results(args.folders)
    for item in found.skipped:
        log(f"skipped {item.folder}: {item.reason}")
    return _compare(args, found) if args.compare else _tabulate(args, found, kind)


def _compare(args: argparse.Namespace, found: "Found") -> int:
    from magical.report.pages.comparison import compare

    comparison = compare(found.results, *args.compare)
    _print_tables(comparison.tables)
    if args.out:
        comparison.write(args.out)
        log(f"wrote {args.out}")
    differences = {name: plain_interval(interval) for name, interval in comparison.overall.items()}
    print_json(args, {"compare": args.compare, "differences": differences, **_skipped(found)})
    return 0


def _skipped(found: "Found") -> dict[str, Any]:
    return {"skipped": [{"folder": str(s.folder), "reason": s.reason} for s in found.skipped]}


def _print_tables(tables: "Iterable[TextTable]") -> None:
    for table in tables:
        print_table(table.header, table.rows)
        print(f"{table.note}\n")


def _tabulate(args: argparse.Namespace, found: "Found", kind: str | None) -> int:
    """Print every table of the page as text, and write the file."""
    from magical.report.pages.export import FORMATS, all_tables, plain_rows
    from magical.report.scores.differences import matching_methods

    published = tuple(matching_methods(found.entries) if args.published is None else args.published)
    _print_tables(all_tables(found, published))
    notes: Sequence[str] = ()
    if kind and kind in FORMATS:
        FORMATS[kind](found, published, args.out)
    elif kind:
        from magical.experiments.entries import policy_of
        from magical.report.pages.evaluated import write_page

        notes = write_page(
            args.out,
            args.title or TITLE,
            found,
            published,
            load_policy=lambda result: policy_of(result.folder, result.entry, result.run),
            clips=args.clips or 0,
        )
    if kind:
        log(f"wrote {args.out}")
    for note in notes:
        log(f"error: no rollouts of {note}")
    print_json(args, {"rows": plain_rows(found, published), **_skipped(found)})
    return int(bool(notes))
