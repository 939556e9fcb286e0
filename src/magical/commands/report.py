"""Make a page of tables and figures from evaluated runs.

DIR is a folder that `magical evaluate POLICY --out DIR` has written, or a folder with such folders
at any depth. Folders with the same method are runs of it and share a row.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import log, positive_int, print_table
from magical.commands._policies import policy_of

if TYPE_CHECKING:
    from magical.report.results import Results

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
    from magical.report.results import find_results

    if args.clips and (args.compare or not args.out or _kind(args) != "html"):
        log("--clips is for a page (--out FILE.html); no rollouts are recorded")
    results = find_results(args.folders)
    for item in results.skipped:
        log(f"skipped {item.folder}: {item.reason}")
    if args.compare:
        return _compare(args, results)
    _print_tables(args, results)
    if args.out:
        _write(args, results)
        log(f"wrote {args.out}")
    return 0


def _compare(args: argparse.Namespace, results: "Results") -> int:
    from magical.report.comparison import compare

    comparison = compare(results.found, *args.compare)
    for grid in comparison.grids:
        print_table(grid.header, grid.rows)
        print(f"{grid.note}\n")
    if args.out:
        comparison.write(args.out)
        log(f"wrote {args.out}")
    return 0


def _print_tables(args: argparse.Namespace, results: "Results") -> None:
    """Every table of the page as text."""
    from magical.report.export import all_grids

    for grid in all_grids(results, _published(args, results)):
        print_table(grid.header, grid.rows)
        print(f"{grid.note}\n")


def _write(args: argparse.Namespace, results: "Results") -> None:
    from magical.report.export import FORMATS
    from magical.report.folders import evaluated_page

    kind, published = _kind(args), _published(args, results)
    if kind in FORMATS:
        FORMATS[kind](results, published, args.out)
        return
    page = evaluated_page(
        args.title,
        results,
        published,
        out=args.out,
        load_policy=lambda result: policy_of(result.folder, result.entry, result.run),
        clips=args.clips or 0,
    )
    page.write(args.out)


def _kind(args: argparse.Namespace) -> str:
    """The format of the file to write."""
    from magical.report.export import format_of

    return str(args.format or format_of(args.out))


def _published(args: argparse.Namespace, results: "Results") -> tuple[str, ...]:
    from magical.report.differences import matching_methods

    if args.published is None:
        return matching_methods(results.entries)
    return tuple(args.published)
