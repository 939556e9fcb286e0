"""Hold the package against recordings of the published environments.

Prints one line for each figure with its limit; the exit status is 1 when a limit is missed. A
recording without answers is only computed, and written with --out.
"""

import argparse
import importlib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import add_json, log, print_json, print_table

if TYPE_CHECKING:
    from magical.conformance.report import Line

HELP = "compare with recordings of the published environments"
KINDS = ("frames", "motions", "scenes", "scores")


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("kind", choices=KINDS, help="what the recording holds")
    parser.add_argument("data", type=Path, metavar="DATA", help="the recording")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write what was computed")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Compute, write, compare."""
    room = importlib.import_module(f"magical.conformance.{args.kind}")
    data = room.load(args.data)
    computed = room.compute(data)
    if args.out:
        room.write(computed, args.out)
        log(f"wrote {args.out}")
    lines: list[Line] = room.compare(data, computed)
    if lines:
        _print(lines)
    else:
        log(f"{args.data} holds no answers: nothing compared")
    passed = all(line.passed for line in lines)
    if args.json:
        report = [asdict(line) for line in lines]
        print_json({"kind": args.kind, "passed": passed, "lines": report})
    return 0 if passed else 1


def _print(lines: "list[Line]") -> None:
    header = ("", "what", "figure", "limit", "unit", "detail")
    rows = [
        (
            "ok" if line.passed else "MISSED",
            line.name,
            f"{line.figure:.4g}",
            f"{line.limit:g}",
            line.unit,
            line.detail,
        )
        for line in lines
    ]
    print_table(header, rows)
