"""Score tables: a row for each method, a column for each variant, in the paper's colour scale."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magical.evaluation import Entry, by_variant, published_score, published_tasks
from magical.evaluation.intervals import Interval, rollout_mean
from magical.evaluation.published import PUBLISHED_RUNS
from magical.evaluation.statistics import over_runs
from magical.messages import decimals
from magical.report.found.rows import by_row
from magical.report.found.statements import MARKS, marked
from magical.report.scores.differences import (
    RULE,
    counterparts,
    differences,
    horizon_of,
    is_comparable,
)
from magical.tasks import Task, get_task
from magical.tasks.axes import SHORT_VARIANTS, short_variant

LIGHTEST, DARKEST = (255, 255, 255), (33, 102, 172)  # RGB of a score of 0 and of 1
INK_CHANGES = 0.8  # higher scores are in white ink; here both inks have a contrast of about 4
ONE_RUN = (
    " In brackets: 95% intervals over the rollouts of one run, which do not include the spread "
    "between training runs."
)
BESIDE = " In parentheses: the difference from the published mean."
APART, FEW = 0.5, 5  # at most FEW runs whose means are more than APART apart are listed singly
RUNS_APART = (
    " Where some runs succeed and others fail, their means are listed in brackets. Where a few "
    "runs all succeed, failures may be missing by chance: if one run in five fails, a 95% interval "
    "covers the true mean in 48% of cases with three runs, and in 67% with five."
)


@dataclass(frozen=True, slots=True)
class Cell:
    """A mean score with its uncertainty."""

    mean: float
    detail: str
    difference: Interval | None = None  # from the published mean
    are_apart: bool = False  # few runs, some of which fail; `detail` lists them

    @property
    def colours(self) -> tuple[str, str]:
        """Background and ink as CSS colours; lower scores are lighter (appendix, Table 5)."""
        share = min(max(self.mean, 0.0), 1.0)
        mixed = [round(a + (b - a) * share) for a, b in zip(LIGHTEST, DARKEST, strict=True)]
        return "rgb({},{},{})".format(*mixed), "#fff" if share > INK_CHANGES else "#222"

    @property
    def number(self) -> str:
        """The mean as text."""
        return decimals(self.mean)

    @property
    def text(self) -> str:
        """Text such as `0.88 ± 0.10 (−0.01)`, with the difference from the published mean."""
        difference = f" ({self.beside[0]})" if self.beside else ""
        return f"{self.number} {self.detail}{difference}"

    @property
    def beside(self) -> list[str]:
        """The difference from the published mean, then its interval, as far as there are any."""
        return [] if self.difference is None else signed(self.difference).split(" ", 1)


@dataclass(frozen=True, slots=True)
class Row:
    """One method's scores on one task, by short variant name."""

    label: str
    cells: Mapping[str, Cell]
    note: str  # how to read the details


@dataclass(frozen=True, slots=True)
class TextTable:
    """A plain-text table with a heading and a note on how to read it."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""


@dataclass(frozen=True, slots=True)
class ScoreTable:
    """All methods' scores on one task."""

    task: str
    variants: tuple[str, ...]  # short names
    rows: tuple[Row, ...]
    note: str  # scoring rule, horizon, and what intervals are over
    published: bool = False  # scored by the published code's rule, with published rows

    def as_text(self) -> TextTable:
        """The table as plain text, without colours and row notes."""
        title = f"{self.task}, beside the published scores" if self.published else self.task
        rows = [
            (row.label, *(row.cells[v].text if v in row.cells else "–" for v in self.variants))
            for row in self.rows
        ]
        return TextTable(title, (self.task, *self.variants), rows, self.note)


def task_table(task: str, entries: Iterable[Entry], published: Iterable[str] = ()) -> ScoreTable:
    """A row for each method among the entries, then the published rows of the named methods.

    A method whose evaluations differ has several rows (`by_row`). With published rows, all scores
    follow the published code's rule, and only rows with the published code's horizon are shown. If
    a method has no such row, the published rows are left out, and the note says so. Methods and
    published tables without the task are left out.
    """
    found, entries = get_task(task), list(entries)
    runs = {label: group for label, group in rows_on(task, entries).items() if group}
    methods = tuple(published) if task in published_tasks() else ()
    theirs = counterparts(entries, methods)
    published_rows = [_published_row(task, method) for method in methods]
    other = _other_horizons(found, runs)
    compared = bool(methods) and not other
    if compared:
        runs = {label: group for label, group in runs.items() if is_comparable(found, group[0])}
    rule = RULE if compared else "score"
    rows = [_method_row(found, row, group, rule) for row, group in runs.items()]
    if compared:
        pairs = zip(rows, runs.values(), strict=True)
        rows = [_beside(row, found, group, theirs) for row, group in pairs] + published_rows
    variants = tuple(map(short_variant, found.variants))
    kept = tuple(row for row in rows if row.cells)
    one_run = any(len(group) == 1 for group in runs.values())
    note = _rule_note(found, compared)
    note += "" if compared else _horizon_note(found, runs)
    note += _left_out_note(found, other) if methods and other else ""
    note += BESIDE if any(cell.difference for row in kept for cell in row.cells.values()) else ""
    note += ONE_RUN if one_run else ""
    note += MARKS if any(marked("", group) for group in runs.values()) else ""
    note += RUNS_APART if any(cell.are_apart for row in kept for cell in row.cells.values()) else ""
    return ScoreTable(task, variants, kept, note, compared)


def rows_on(task: str, entries: Iterable[Entry]) -> dict[str, list[Entry]]:
    """The entries of each row that have a task, by the labels of `by_row`."""
    rows = by_row(entries, lambda entry: entry)
    return {
        label: [entry for entry in row if task in by_variant(entry.scores)]
        for label, row in rows.items()
    }


def entry_tasks(entries: Iterable[Entry]) -> tuple[str, ...]:
    """The tasks on which any entry has scores, in order of first appearance."""
    return tuple(dict.fromkeys(task for entry in entries for task in by_variant(entry.scores)))


def report_tables(entries: Sequence[Entry], published: Sequence[str] = ()) -> list[ScoreTable]:
    """The tables of every task: by the appendix's rule, and by the published one if comparable.

    If the two rules and horizons are the same, one table shows both.
    """
    tables = []
    for name in entry_tasks(entries):
        beside, task = task_table(name, entries, published), get_task(name)
        with_task = (entry for entry in entries if name in by_variant(entry.scores))
        all_shown = all(is_comparable(task, entry) for entry in with_task)
        if beside.published and (_rules_differ(task) or not all_shown):
            tables.append(task_table(name, entries))
        tables.append(beside)
    return tables


def _method_row(task: Task, method: str, runs: Sequence[Entry], rule: str) -> Row:
    tables = [by_variant(run.scores)[task.name] for run in runs]
    cells = {}
    for variant in SHORT_VARIANTS:
        scores = [[getattr(row, rule) for row in t[variant]] for t in tables if variant in t]
        if scores:
            cells[variant] = _cell(scores, len(runs))
    note = (
        f"mean ± std over {len(runs)} runs" if len(runs) > 1 else "mean, 95% interval over rollouts"
    )
    return Row(marked(method, runs), cells, note)


def _beside(row: Row, task: Task, runs: Sequence[Entry], theirs: Mapping[str, str]) -> Row:
    """A row of ours with its differences from its published counterpart."""
    method = theirs.get(runs[0].method)
    found = differences(task, runs, method) if method else {}
    if not found:
        return row
    cells = {
        variant: replace(cell, difference=found.get(variant)) for variant, cell in row.cells.items()
    }
    exact = ", except on Demo, which is nudged" if any(run.nudge for run in runs) else ""
    return replace(row, cells=cells, note=f"{row.note}; difference from {method}{exact}")


def signed(interval: Interval) -> str:
    """A difference with its interval, as text: `+0.02 [−0.10, +0.14]`."""
    if math.isnan(interval.low):
        return decimals(interval.value, sign="+")
    value, low, high = (decimals(number, sign="+") for number in interval)
    return f"{value} [{low}, {high}]"


def _cell(runs: Sequence[Sequence[float]], expected: int) -> Cell:
    """A cell from the scores of each run's rollouts; says if fewer runs than expected have any."""
    few = "" if len(runs) == expected else f" ({len(runs)} of {expected} runs)"
    if len(runs) > 1:
        means = [float(np.mean(run)) for run in runs]
        mean, std = over_runs([[value] for value in means])
        listed = means_apart(means)
        return Cell(mean, f"± {std:.2f}{listed}{few}", are_apart=bool(listed))
    value, low, high = rollout_mean(runs[0])
    return Cell(value, f"[{low:.2f}, {high:.2f}]{few}")


def means_apart(means: Sequence[float]) -> str:
    """A few runs' means, such as ` (1.00, 0.00, 0.75)`, if some succeed and some fail."""
    if len(means) > FEW or max(means) - min(means) <= APART:
        return ""
    return f" ({', '.join(f'{value:.2f}' for value in means)})"


def _published_row(task: str, method: str) -> Row:
    spreads = {variant: published_score(task, method, variant) for variant in SHORT_VARIANTS}
    cells = {
        variant: Cell(spread.mean, f"± {spread.std:.2f}")
        for variant, spread in spreads.items()
        if spread is not None
    }
    return Row(f"{method}, published", cells, f"mean ± std over {PUBLISHED_RUNS} runs")


def _horizon_note(task: Task, runs: Mapping[str, Sequence[Entry]]) -> str:
    """The rows whose horizon differs from the appendix's."""
    found = {row: sorted({horizon_of(task, run) for run in group}) for row, group in runs.items()}
    other = [
        f"{row} ({' and '.join(map(str, steps))})"
        for row, steps in found.items()
        if steps != [task.horizon]
    ]
    if not other:
        return ""
    return (
        f" Evaluated with another horizon than the appendix's {task.horizon} control steps: "
        f"{'; '.join(other)}."
    )


def _other_horizons(task: Task, runs: Mapping[str, Sequence[Entry]]) -> list[str]:
    """The horizons, in control steps, of methods that have no row with the published code's."""
    first = [group[0] for group in runs.values()]  # all runs of a row have the same horizon
    compared = {entry.method for entry in first if is_comparable(task, entry)}
    found = {horizon_of(task, entry) for entry in first if entry.method not in compared}
    return list(map(str, sorted(found)))


def _left_out_note(task: Task, other: Sequence[str]) -> str:
    """Why published rows are left out: the horizons that differ from theirs."""
    steps = task.resolve_horizon("published")
    asked = "published" if task.has_two_horizons else steps
    return (
        f" The published rows are left out: their horizon is {steps} control "
        f"steps, not {' or '.join(other)}; evaluate with --horizon {asked} to compare."
    )


def _rule_note(task: Task, published: bool) -> str:
    if not published:
        return "Scored by the appendix's rule."
    if not _rules_differ(task):
        return "On this task, the published code's rule and horizon are the same as the appendix's."
    horizon = f", whose horizon is {task.published_horizon} control steps"
    return (
        "All rows are scored by the published code's rule, as the published ones are"
        f"{horizon if task.has_two_horizons else ''}."
    )


def _rules_differ(task: Task) -> bool:
    return task.published_score_fn is not None or task.has_two_horizons
