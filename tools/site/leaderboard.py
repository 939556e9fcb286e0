"""The page of ranked entries."""

from collections.abc import Iterator

from magical.report.leaderboard import Board, Leaderboard, Standing, by_reasons
from magical.report.table import interval_text
from magical.runs import SOURCES, TRACKS
from tools.readme_tables import table

NO_BREAK = "\u00a0"  # a no-break space, to keep figures on one line
HEADER = ("Rank", "Method", "TestAll", "Gap", "Track", "Used", "Demonstrations", "Over")


def pages(board: Leaderboard) -> dict[str, str | bytes]:
    """The page, by its path in the site."""
    return {"leaderboard.md": "\n\n".join(_parts(board)) + "\n"}


def _parts(board: Leaderboard) -> Iterator[str]:
    yield (
        "# Leaderboard\n\nMethods by their mean score on TestAll, beside the generalisation gap "
        "(Demo minus TestAll), with 95% intervals over training runs, or over rollouts where there "
        "are fewer than three runs or runs do not differ. Entries are those of the "
        "[studies](studies/README.md) and those that were [submitted](entries/README.md) and "
        "accepted: they follow [the protocol](protocol.md), and a sample of their rollouts was "
        "rerun. A reference learned nothing and sees the true "
        "state; it is not ranked. Methods with a prior made for this benchmark are ranked "
        "separately; †: test variants had been evaluated while the method was designed."
    )
    tracks = ((name, SOURCES[source]) for name, source in TRACKS.items())
    yield table(("Track", "What it may use"), tracks)
    for part in board.boards:
        yield f"## {part.name}\n\n{_standings(part)}"
    yield "## Not ranked\n\nEntries of the studies that were evaluated in another way:"
    yield table(
        ("Entries", "Reason"),
        ((len(entries), reasons) for reasons, entries in by_reasons(board.rejected)),
    )


def _standings(part: Board) -> str:
    return table(HEADER, (_row(row) for row in part.standings))


def _row(row: Standing) -> list[object]:
    return [
        "reference" if row.is_reference else row.rank,
        row.label + row.statements.mark,
        interval_text(row.test_all, row.unit).replace(" ", NO_BREAK) + row.runs_apart,
        interval_text(row.gap, row.unit).replace(" ", NO_BREAK),
        row.track or "–",
        ", ".join(row.used) or "nothing",
        row.statements.demonstrations or "–",
        row.unit,
    ]
