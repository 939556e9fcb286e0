"""Reports of evaluated runs in all formats: a page, Markdown, CSV."""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from magical import __version__
from magical.envs import EnvId
from magical.errors import UnknownNameError
from magical.evaluation import published_score, published_tasks
from magical.evaluation.statistics import OverRollouts, over_runs
from magical.files import write_atomically
from magical.report.figures import LoadPolicy, curves_by_task, interval_plot, record_reels
from magical.report.found import Found
from magical.report.table import (
    PUBLISHED_RULE,
    RULE,
    Cell,
    Method,
    Rows,
    TextTable,
    compared_methods,
    counterparts,
    differences,
    gather_statements,
    rows_of,
    score_tables,
    summary_tables,
    track,
)
from magical.tasks import get_task
from magical.tasks.axes import CHANGED, full_variant, short_variant

DIGITS = 6  # significant, in CSV
LIGHTEST, DARKEST = (255, 255, 255), (33, 102, 172)  # RGB of a score of 0 and of 1
INK_CHANGES = 0.8  # higher scores are in white ink; here both inks have a contrast of about 4
SUFFIXES = {".html": "html", ".csv": "csv", ".md": "markdown"}


def format_of(path: Path) -> str:
    """The format for a file's suffix, HTML if it has none; raises `UnknownNameError`."""
    kind = SUFFIXES.get(path.suffix.lower() or ".html")
    if kind is None:
        raise UnknownNameError(f"{path}: expected the suffix {', '.join(SUFFIXES)}, or --format")
    return kind


def all_tables(rows: Rows, published: Sequence[str]) -> list[TextTable]:
    """All tables of a page, as plain text."""
    return [*(table.as_text() for table in score_tables(rows, published)), *summary_tables(rows)]


def write_markdown(found: Found, published: Sequence[str], path: Path) -> None:
    """Write all tables in Markdown."""
    write_text(path, "\n".join(map(markdown, all_tables(rows_of(found.entries), published))))


def markdown(table: TextTable) -> str:
    """A table in Markdown, with its heading and note."""

    def escaped(text: str) -> str:
        return re.sub(r"([\\|`*_<>\[\]])", r"\\\1", text)

    rows = [table.header, ["---"] * len(table.header), *table.rows]
    lines = [f"| {' | '.join(map(escaped, row))} |" for row in rows]
    return "\n".join([f"## {escaped(table.title)}", "", *lines, "", escaped(table.note), ""])


def write_csv(found: Found, published: Sequence[str], path: Path) -> None:
    """Write the rows of `plain_rows` as CSV, numbers to `DIGITS` digits; empty for `None`."""
    text = io.StringIO()
    rows = plain_rows(rows_of(found.entries), published)
    writer = csv.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _text(value) for name, value in row.items()} for row in rows)
    write_text(path, text.getvalue())


def _text(value: float | str | None) -> str:
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{value}"  # a name that a spreadsheet would take for a formula
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    return "" if value is None else str(value)


def plain_rows(rows: Rows, published: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each method and environment, as plain data; `None` for missing values.

    `score` and its interval follow the appendix's rule, `published_code_score` and the difference
    follow the published code's. The last columns say how the environment was evaluated.
    """
    return [row for task in rows.tasks for row in _plain_rows(task, rows, published)]


def _plain_rows(name: str, rows: Rows, published: Sequence[str]) -> Iterator[dict[str, Any]]:
    """A row for each method and variant of a task, by column name."""
    task, table, rows = get_task(name), rows.scores, rows.on(name)
    methods = counterparts(rows, published if name in published_tasks() else ())
    for label, runs in rows.items():
        theirs = methods.get(runs[0].method)
        changes = differences(task, runs, theirs) if theirs else {}
        statements = gather_statements(runs)
        how = runs[0].evaluated  # the same for all runs of a row, but for environments
        how_on_task = how.settings | {"horizon": task.resolve_horizon(how.horizon)}
        for variant in dict.fromkeys(s[2] for s in table if s[:2] == (label, name)):
            scores = table[label, name, variant, RULE]
            interval = Method("", runs, ()).on([EnvId(name, full_variant(variant))]).mean()
            change = changes.get(variant)
            spread = published_score(name, theirs, variant) if theirs and change else None
            rule = [score.score for score in table[label, name, variant, PUBLISHED_RULE]]
            numbers = {
                "score": interval.value,
                "score_std": over_runs([[s.score] for s in scores]).std if scores[1:] else None,
                "score_low": interval.low,
                "score_high": interval.high,
                PUBLISHED_RULE: float(np.mean(rule)),
                "published_method": theirs,
                "published": spread and spread.mean,
                "published_std": spread and spread.std,
                "difference": change and change.value,
                "difference_low": change and change.low,
                "difference_high": change and change.high,
            }
            yield {
                "task": name,
                "variant": variant,
                "method": label,
                "runs": len(scores),
                "interval_over": "rollouts" if isinstance(interval, OverRollouts) else "runs",
                **{key: None if value != value else value for key, value in numbers.items()},
                "track": track(runs) or None,
                "test_evaluations": statements.test_evaluations,
                **how_on_task,
            }


def write_page(
    path: Path,
    title: str,
    found: Found,
    published: Sequence[str] = (),
    *,
    load_policy: LoadPolicy | None = None,
    clips: int = 0,
    conclusions: Sequence[str] = (),
) -> Sequence[str]:
    """Write a page with all results of evaluated runs and their training, in one file.

    `published` are rows of the published tables to show, `clips` the number of runs whose best,
    median and worst rollouts are recorded, `conclusions` sentences at the beginning. Returns why
    there are no rollouts, if some were requested and none could be recorded.
    """
    reels, notes = (
        record_reels(found.results, load_policy, clips) if load_policy and clips else ([], [])
    )
    rows = rows_of(found.entries)
    curves, damaged = curves_by_task(found.results)
    skipped = [(str(item.folder), item.reason) for item in found.skipped]
    skipped += [(str(folder), reason) for folder, reason in damaged.items()]
    means = {method.name: method.interquartile_mean() for method in compared_methods(rows)}
    evaluated = {env_id.variant for run in found.entries for env_id in run.evaluated.env_ids}
    counts = {entry.evaluated.rollouts for entry in found.entries}
    html = render_template(
        "page.html.j2",
        title=title,
        subtitle=_subtitle(found, len(skipped)),
        conclusions=conclusions,
        changed={short_variant(v): text for v, text in CHANGED.items() if v in evaluated},
        colours=_colours,
        lightest=f"rgb{LIGHTEST}",
        darkest=f"rgb{DARKEST}",
        tables=score_tables(rows, published),
        rollouts=" to ".join(map(str, sorted({min(counts), max(counts)}))),
        summaries=[asdict(table) for table in summary_tables(rows)],
        means=interval_plot(means, "interquartile mean", "iqm") if means else "",
        curves=curves,
        reels=reels,
        clip_notes=notes,
        skipped=skipped,
        version=__version__,
    )
    write_text(path, html)
    return () if reels else notes


def _colours(cell: Cell) -> str:
    """Background and ink of a cell as CSS; lower scores are lighter (appendix, Table 5)."""
    share = min(max(cell.mean, 0.0), 1.0)
    mixed = [round(a + (b - a) * share) for a, b in zip(LIGHTEST, DARKEST, strict=True)]
    ink = "#fff" if share > INK_CHANGES else "#222"
    return "background:rgb({},{},{});color:{}".format(*mixed, ink)


def _subtitle(found: Found, skipped: int) -> str:
    methods, runs = len({entry.method for entry in found.entries}), len(found.results)
    text = f"{runs} evaluated run{'s' * (runs != 1)} of {methods} method{'s' * (methods != 1)}"
    return text + (f"; {skipped} skipped" if skipped else "")


def render_template(name: str, **values: Any) -> str:
    """Render one of this package's templates; values are escaped."""
    import jinja2  # from the `report` extra

    options: Any = {"autoescape": True, "trim_blocks": True, "lstrip_blocks": True}
    loader, undefined = jinja2.PackageLoader("magical.report"), jinja2.StrictUndefined
    environment = jinja2.Environment(loader=loader, undefined=undefined, **options)
    return environment.get_template(name).render(**values)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, in UTF-8; undecodable bytes of file names are escaped."""
    with write_atomically(path) as file:
        file.write(text.encode(errors="backslashreplace"))


FORMATS: Mapping[str, Any] = {"csv": write_csv, "markdown": write_markdown}
