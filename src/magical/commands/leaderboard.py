"""Make a leaderboard of evaluated entries: static pages that can be put on any web server.

FOLDER holds entries (folders with scores.csv and entry.json) at any depth. Each is checked against
the protocol; methods are ranked by TestAll and by the generalisation gap; entries that are not
ranked are listed with the reason.
"""

import argparse
from pathlib import Path
from typing import Any

from magical.commands import _common as common
from magical.extras import require
from magical.messages import for_terminal
from magical.report.leaderboard import Standing, by_reasons, make_leaderboard
from magical.report.table import interval_text


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of entries")
    common.add_out(parser, "folder to write index.html and the other pages to")
    meaning = "mark methods whose rollouts you have rerun (magical verify)"
    common.add_several(parser, "--rerun", meaning, "METHOD", default=[])
    common.add_json(parser)


def run(args: argparse.Namespace) -> int:
    if args.out:
        require("report")
    board = make_leaderboard(args.folders, args.rerun)
    for part in board.boards:
        rows = [
            {
                "rank": row.place,
                part.name: row.label,
                "TestAll": row.statements.mark
                + interval_text(row.test_all, row.unit)
                + row.runs_apart,
                "gap": interval_text(row.gap, row.unit),
                "rank by gap": row.gap_place,
                "intervals over": row.unit,
                "track": row.track or "–",
                "used": ", ".join(row.used) or "–",
            }
            for row in part.standings
        ]
        if rows:
            common.print_records(rows)
        else:
            print("no method has entries on all tasks")
        print()
    for reasons, entries in by_reasons(board.rejected):
        more = f" and {len(entries) - 1} more" if entries[1:] else ""
        print(for_terminal(f"not ranked: {entries[0].folder}{more}: {reasons}"))
    if args.out:
        board.write(args.out)
        common.log(f"wrote {args.out / 'index.html'}")
    boards = {part.name: [_plain(row) for row in part.standings] for part in board.boards}
    rejected = [{"folder": e.folder, "reasons": list(e.reasons)} for e in board.rejected]
    common.print_json(args, {"boards": boards, "rejected": rejected})
    return 0


def _plain(row: Standing) -> dict[str, Any]:
    """A method's standing as plain data; ranks are `None` if it has none, and so is NaN."""
    intervals = {"test_all": row.test_all, "demo": row.demo, "gap": row.gap}
    return {
        "method": row.method,
        "rank": row.rank if row.is_ranked else None,
        "rank_by_gap": row.gap_rank if row.is_ranked else None,
        **{name: [x if x == x else None for x in three] for name, three in intervals.items()},
        "track": row.track,
        "used": row.used,
        **row.statements._asdict(),
    }
