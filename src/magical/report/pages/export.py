"""The tables as CSV and Markdown."""

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.errors import UnknownNameError
from magical.evaluation import Entry, by_variant, published_score, published_tasks
from magical.evaluation.intervals import OverRollouts
from magical.evaluation.statistics import over_runs
from magical.report.found.search import Found
from magical.report.found.statements import LOOKS, class_of
from magical.report.pages.page import write_text
from magical.report.scores.differences import RULE, counterparts, differences
from magical.report.scores.methods import compared_methods, make_method
from magical.report.scores.summaries import aggregate_table, gap_table
from magical.report.scores.tables import TextTable, entry_tasks, report_tables, rows_on
from magical.tasks import get_task
from magical.tasks.axes import full_variant

DIGITS = 6  # significant, in CSV
Write = Callable[[Found, Sequence[str], Path], None]


def all_tables(found: Found, published: Sequence[str]) -> list[TextTable]:
    """All tables of a page, as plain text."""
    entries = found.entries
    tables = [table.as_text() for table in report_tables(entries, published)]
    if methods := compared_methods(entries):
        tables.append(aggregate_table(methods, entries))
        tables += [gaps] if (gaps := gap_table(methods)) else []
    return tables


def write_csv(found: Found, published: Sequence[str], path: Path) -> None:
    """Write the rows of `plain_rows` as CSV, numbers to `DIGITS` digits; empty for `None`."""
    text = io.StringIO()
    rows = plain_rows(found, published)
    writer = csv.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _text(value) for name, value in row.items()} for row in rows)
    write_text(path, text.getvalue())


def plain_rows(found: Found, published: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each method and environment, as plain data; `None` for missing values.

    `score` and its interval follow the appendix's rule, `published_code_score` and the difference
    follow the published code's. The last columns say how the environment was evaluated.
    """
    return [row for task in entry_tasks(found.entries) for row in _rows(task, found, published)]


def write_markdown(found: Found, published: Sequence[str], path: Path) -> None:
    """Write all tables in Markdown."""
    write_text(path, "\n".join(map(markdown, all_tables(found, published))))


FORMATS: Mapping[str, Write] = {"csv": write_csv, "markdown": write_markdown}
_SUFFIXES = {".html": "html", ".csv": "csv", ".md": "markdown"}


def format_of(path: Path) -> str:
    """The format for a file's suffix, HTML if it has none; raises `UnknownNameError`."""
    kind = _SUFFIXES.get(path.suffix.lower() or ".html")
    if kind is None:
        raise UnknownNameError(f"{path}: expected the suffix {', '.join(_SUFFIXES)}, or --format")
    return kind


def markdown(table: TextTable) -> str:
    """A table in Markdown, with its heading and note."""
    rows = [table.header, tuple("---" for _ in table.header), *table.rows]
    lines = [f"| {' | '.join(_escape_markdown(cell) for cell in row)} |" for row in rows]
    return "\n".join(
        [f"## {_escape_markdown(table.title)}", "", *lines, "", _escape_markdown(table.note), ""]
    )


def _escape_markdown(text: str) -> str:
    return re.sub(r"([\\|`*_<>\[\]])", r"\\\1", text)


def _rows(task: str, found: Found, published: Sequence[str]) -> Iterator[dict[str, Any]]:
    """A row for each method and variant of a task, by column name."""
    rows = counterparts(found.entries, published if task in published_tasks() else ())
    for method, runs in rows_on(task, found.entries).items():
        for variant in dict.fromkeys(v for run in runs for v in by_variant(run.scores)[task]):
            figures = _figures(task, variant, runs, rows.get(runs[0].method))
            # The same for all runs of a row.
            settings = runs[0].evaluated.on(EnvId(task, full_variant(variant))).settings
            yield {"task": task, "variant": variant, "method": method, **figures, **settings}


def _figures(task: str, variant: str, runs: Sequence[Entry], theirs: str | None) -> dict[str, Any]:
    cells = [cell for run in runs if (cell := by_variant(run.scores)[task].get(variant))]
    method = make_method("", runs, [cells[0][0].env_id])
    interval = method.mean()
    rule = [np.mean([getattr(row, RULE) for row in cell]) for cell in cells]
    found = differences(get_task(task), runs, theirs).get(variant) if theirs else None
    spread = published_score(task, theirs, variant) if theirs and found else None
    numbers = {
        "score": interval.value,
        "score_std": over_runs(method.means).std if len(cells) > 1 else None,
        "score_low": interval.low,
        "score_high": interval.high,
        RULE: float(np.mean(rule)),
        "published_method": theirs,
        "published": spread and spread.mean,
        "published_std": spread and spread.std,
        "difference": found and found.value,
        "difference_low": found and found.low,
        "difference_high": found and found.high,
    }
    known = {
        name: None if isinstance(number, float) and math.isnan(number) else number
        for name, number in numbers.items()
    }
    over = "rollouts" if isinstance(interval, OverRollouts) else "runs"
    return {"runs": len(cells), "interval_over": over, **known, **_stated(runs)}


def _stated(runs: Sequence[Entry]) -> dict[str, Any]:
    """The class of the runs, and the largest number of looks that one of them states."""
    looks = [number for run in runs if isinstance(number := run.details.get(LOOKS), int)]
    return {"class": class_of(runs) or None, "looks": max(looks, default=None)}


def _text(value: float | str | None) -> str:
    if value is None:
        return ""
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{value}"  # a name that a spreadsheet would take for a formula
    return f"{value:.{DIGITS}g}" if isinstance(value, float) else str(value)
