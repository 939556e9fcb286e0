"""A page from folders of evaluated runs."""

from collections.abc import Sequence
from pathlib import Path

from magical.evaluation import Entry
from magical.report.aggregate import aggregate_header, aggregate_rows, aggregates
from magical.report.curves import learning_curves
from magical.report.page import Page
from magical.report.tables import Table


def evaluated_page(
    title: str, folders: Sequence[Path], entries: Sequence[Entry], tables: Sequence[Table]
) -> Page:
    """Tables, learning curves where the folders hold training runs, and where it all is from."""
    facts = {
        f"{entry.row} ({folder})": ", ".join(
            f"{name} {value}"
            for name, value in (
                ("observation", entry.observation),
                ("horizon", entry.horizon),
                ("seeds", entry.seed),
                ("version", entry.version),
                *entry.details.items(),
            )
            if value != ""
        )
        for folder, entry in zip(folders, entries, strict=True)
    }
    lines, note = aggregates(entries)
    return Page(
        title=title,
        subtitle=f"{len(entries)} evaluated runs",
        tables=tables,
        rollouts=max(row.rollout for entry in entries for row in entry.scores) + 1,
        aggregate=[aggregate_header(lines), *aggregate_rows(lines)] if lines else (),
        aggregate_note=note,
        curves=learning_curves(dict(zip(map(str, folders), folders, strict=True))),
        facts=facts,
    )
