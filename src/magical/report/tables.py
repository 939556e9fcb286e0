"""Score tables: a row for each method, a column for each variant, in the paper's colour scale."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from magical.evaluation import Entry, by_variant, published_score, published_tasks
from magical.evaluation.intervals import rollout_mean
from magical.evaluation.published import RUNS
from magical.evaluation.statistics import over_runs
from magical.evaluation.variants import SHORT_VARIANTS, short_variant
from magical.tasks import Task, get_task

LIGHTEST, DARKEST = (255, 255, 255), (33, 102, 172)  # RGB of a score of 0 and of 1
INK_CHANGES = 0.55  # scores above are written in white
ONE_RUN = (
    " In brackets: 95% intervals over the rollouts of one run, which do not include the spread "
    "between training runs."
)


@dataclass(frozen=True, slots=True)
class Cell:
    """A mean score, and how sure it is."""

    mean: float
    detail: str

    @property
    def colours(self) -> tuple[str, str]:
        """Background and ink as CSS: the worse, the lighter (appendix, Table 5)."""
        share = min(max(self.mean, 0.0), 1.0)
        mixed = [round(a + (b - a) * share) for a, b in zip(LIGHTEST, DARKEST, strict=True)]
        return "rgb({},{},{})".format(*mixed), "#fff" if share > INK_CHANGES else "#222"


@dataclass(frozen=True, slots=True)
class Row:
    """One method's scores on one task, by short variant name."""

    label: str
    cells: Mapping[str, Cell]
    note: str  # how the details are to be read


@dataclass(frozen=True, slots=True)
class Table:
    """All methods' scores on one task."""

    task: str
    variants: tuple[str, ...]  # short names
    rows: tuple[Row, ...]
    note: str  # by which rule and horizon, and what intervals are over


def task_table(task: str, entries: Iterable[Entry], published: Iterable[str] = ()) -> Table:
    """A row for each method among the entries, then the published rows of the methods named.

    Entries with the same method are runs of it. With published rows, all scores are by the
    published code's rule; where an entry's horizon is another than the published code's, the
    published rows are left out, and the note says so. Methods and published tables without the
    task are left out.
    """
    found = get_task(task)
    runs: dict[str, list[Entry]] = {}
    for entry in entries:
        runs.setdefault(entry.row, []).append(entry)
    methods = tuple(published) if task in published_tasks() else ()
    published_rows = [_published_row(task, method) for method in methods]
    other = _other_horizons(found, [entry for group in runs.values() for entry in group])
    compared = bool(methods) and not other
    rule = "published_code_score" if compared else "score"
    rows = [_method_row(found, method, group, rule) for method, group in runs.items()]
    rows += published_rows if compared else []
    variants = tuple(map(short_variant, found.variants))
    kept = tuple(row for row in rows if row.cells)
    one_run = any(len(runs[row.label]) == 1 for row in kept if row.label in runs)
    note = _rule_note(found, compared)
    note += _left_out_note(found, other) if methods and other else ""
    return Table(task, variants, kept, note + (ONE_RUN if one_run else ""))


def entry_tasks(entries: Iterable[Entry]) -> tuple[str, ...]:
    """The tasks that any of the entries has scores on, in the order in which they come."""
    return tuple(dict.fromkeys(task for entry in entries for task in by_variant(entry.scores)))


def text_rows(table: Table) -> list[tuple[str, ...]]:
    """A table as plain text: a line for each method, a cell for each of all variants."""
    return [
        (
            row.label,
            *(
                f"{row.cells[v].mean:.2f} {row.cells[v].detail}" if v in row.cells else "–"
                for v in table.variants
            ),
        )
        for row in table.rows
    ]


def _method_row(task: Task, method: str, runs: Sequence[Entry], rule: str) -> Row:
    tables = [by_variant(run.scores).get(task.name, {}) for run in runs]
    cells = {
        variant: _cell([[getattr(row, rule) for row in table[variant]] for table in tables])
        for variant in SHORT_VARIANTS
        if all(variant in table for table in tables)
    }
    note = (
        f"mean ± std over {len(runs)} runs" if len(runs) > 1 else "mean, 95% interval over rollouts"
    )
    return Row(method, cells, f"{note}{_horizon_note(task, runs)}")


def _cell(runs: Sequence[Sequence[float]]) -> Cell:
    """From the scores of each run's rollouts."""
    if len(runs) > 1:
        mean, std = over_runs([[float(np.mean(run))] for run in runs])
        return Cell(mean, f"± {std:.2f}")
    value, low, high = rollout_mean(runs[0])
    return Cell(value, f"[{low:.2f}, {high:.2f}]")


def _published_row(task: str, method: str) -> Row:
    spreads = {variant: published_score(task, method, variant) for variant in SHORT_VARIANTS}
    cells = {
        variant: Cell(spread.mean, f"± {spread.std:.2f}")
        for variant, spread in spreads.items()
        if spread is not None
    }
    return Row(f"{method}, published", cells, f"mean ± std over {RUNS} runs")


def _horizon_note(task: Task, runs: Sequence[Entry]) -> str:
    """Which horizon, where the published code's differs from the appendix's."""
    if not task.has_two_horizons:
        return ""
    steps = sorted({_steps(task, run) for run in runs})
    return f"; horizon {' and '.join(steps)}"


def _steps(task: Task, entry: Entry) -> str:
    """An entry's horizon in control steps."""
    used = {"appendix": task.horizon, "published": task.published_horizon}
    return str(used.get(entry.horizon, entry.horizon))


def _other_horizons(task: Task, entries: Sequence[Entry]) -> list[str]:
    """The horizons of the task's entries that are not the published code's, in control steps."""
    found = {_steps(task, entry) for entry in entries if task.name in by_variant(entry.scores)}
    return sorted(found - {str(task.published_horizon)})


def _left_out_note(task: Task, other: Sequence[str]) -> str:
    """Why published rows are left out: which horizons are not theirs."""
    asked = "published" if task.has_two_horizons else task.published_horizon
    return (
        f" The published rows are left out: their horizon is {task.published_horizon} control "
        f"steps, not {' or '.join(other)}; evaluate with --horizon {asked} to compare."
    )


def _rule_note(task: Task, published: bool) -> str:
    if not published:
        return "Scored by the appendix's rule."
    if task.published_score_fn is None and not task.has_two_horizons:
        return "The published code's rule and horizon are the appendix's on this task."
    horizon = f", whose horizon is {task.published_horizon} control steps"
    return (
        "All rows are scored by the published code's rule, as the published ones are"
        f"{horizon if task.has_two_horizons else ''}."
    )
