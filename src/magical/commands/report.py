"""Make a page of tables and figures from evaluated runs.

DIR is a folder that `magical evaluate POLICY --out DIR` has written, or a folder with such folders
at any depth. Folders with the same method are runs of it and share a row.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import log, positive_int, print_table

if TYPE_CHECKING:
    from magical.report.found.search import Found

HELP = "make a page of tables from evaluated runs"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="evaluated runs")
    parser.add_argument(
        "--published",
        nargs="+",
        metavar="METHOD",
        help='rows of the published tables to show below, such as "BC (ST)" (default: those of the '
        "methods' names)",
    )
    parser.add_argument("--title", default="MAGICAL: results")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write a page, or what --format says, there"
    )
    parser.add_argument(
        "--format",
        choices=("html", "csv", "markdown", "latex"),
        help="of FILE (default: by its suffix .html, .csv, .md or .tex)",
    )
    parser.add_argument(
        "--compare",
        nargs=2,
        metavar=("A", "B"),
        help="a page on the difference between two methods instead",
    )
    parser.add_argument(
        "--clips",
        type=positive_int,
        metavar="N",
        help="show the best, median and worst rollouts of N runs, recorded again with their "
        "policies (default: none)",
    )


def run(args: argparse.Namespace) -> int:
    """Read, tabulate, write."""
    from magical.extras import require
    from magical.report.found.search import find_results

    is_page = bool(args.out) and (args.compare or _kind(args) == "html")
    if args.clips and (args.compare or not is_page):
        log("error: --clips is for a page (--out FILE.html); no rollouts are recorded")
        return 1
    if is_page:
        require("report")
    found = find_results(args.folders)
    for item in found.skipped:
        log(f"skipped {item.folder}: {item.reason}")
    if args.compare:
        return _compare(args, found)
    _print_tables(args, found)
    return _write(args, found) if args.out else 0


def _compare(args: argparse.Namespace, found: "Found") -> int:
    from magical.report.pages.comparison import compare

    comparison = compare(found.results, *args.compare)
    for grid in comparison.grids:
        print_table(grid.header, grid.rows)
        print(f"{grid.note}\n")
    if args.out:
        comparison.write(args.out)
        log(f"wrote {args.out}")
    return 0


def _print_tables(args: argparse.Namespace, found: "Found") -> None:
    """Every table of the page as text."""
    from magical.report.pages.export import all_grids

    for grid in all_grids(found, _published(args, found)):
        print_table(grid.header, grid.rows)
        print(f"{grid.note}\n")


def _write(args: argparse.Namespace, found: "Found") -> int:
    from magical.experiments.entries import policy_of
    from magical.report.pages.evaluated import evaluated_page
    from magical.report.pages.export import FORMATS

    kind, published = _kind(args), _published(args, found)
    notes: Sequence[str] = ()
    if kind in FORMATS:
        FORMATS[kind](found, published, args.out)
    else:
        page = evaluated_page(
            args.title,
            found,
            published,
            out=args.out,
            load_policy=lambda result: policy_of(result.folder, result.entry, result.run),
            clips=args.clips or 0,
        )
        page.write(args.out)
        notes = page.clip_notes if args.clips and not page.extremes else ()
    log(f"wrote {args.out}")
    for note in notes:
        log(f"error: no rollouts of {note}")
    return int(bool(notes))


def _kind(args: argparse.Namespace) -> str:
    """The format of the file to write."""
    from magical.report.pages.export import format_of

    return str(args.format or format_of(args.out))


def _published(args: argparse.Namespace, found: "Found") -> tuple[str, ...]:
    from magical.report.scores.differences import matching_methods

    if args.published is None:
        return matching_methods(found.entries)
    return tuple(args.published)
