"""The table behind all reports, and the formats made from it: HTML, Markdown, CSV, plain data.

`Rows.scores` is the table: each run's scores by method, task, variant and rule. The score tables of
a page and the rows of a CSV file are made of it.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from magical import __version__
from magical.envs import EnvId
from magical.errors import UnknownNameError
from magical.evaluation import Entry, by_variant, statistics
from magical.evaluation import published as paper
from magical.evaluation.statistics import FEWEST_RUNS, Floats, Interval, OverRollouts
from magical.files import write_atomically
from magical.grouping import group_by
from magical.messages import decimals
from magical.report.figures import LoadPolicy, curves_by_task, record_reels
from magical.report.found import Found, by_row
from magical.runs import track_of
from magical.tasks import Task, get_task
from magical.tasks.axes import CHANGED, SHORT_VARIANTS, full_variant, short_variant

RULE, PUBLISHED_RULE = statistics.RULES
APART, FEW = 0.5, 5  # at most FEW runs whose means are more than APART apart are listed singly
MARKS = (
    " After a method's name, † says that test variants were evaluated while it was designed, and "
    "the letter in brackets is its track (docs/protocol.md)."
)
ONE_RUN = (
    " In brackets: 95% intervals over the rollouts of one run, which do not include the spread "
    "between training runs."
)
BESIDE = " With a sign: the difference from the published mean."
RUNS_APART = (
    " Where some runs succeed and others fail, their means are listed in brackets. Where a few "
    "runs all succeed, failures may be missing by chance: if one run in five fails, a 95% interval "
    "covers the true mean in 48% of cases with three runs, and in 67% with five."
)
INTERVALS = (
    "95% intervals over training runs; with fewer than three runs of an environment, or where runs "
    "do not differ, they are over rollouts, and do not include the spread between training runs. "
    "The interquartile mean has no interval then."
)
GAPS = (
    "The mean score on Demo minus that on the variant, by task, averaged over the tasks that have "
    "the variant: the larger, the worse the method generalises along that axis. Intervals as above."
)
ABSENT = "–"  # in a cell
SHOWN = 6  # environments named in a note
DIGITS = 6  # significant, in CSV
SUFFIXES = {".html": "html", ".csv": "csv", ".md": "markdown"}


class Rows(dict[str, list[Entry]]):
    """The runs of each row of tables, by its label, and the table of their scores."""

    @cached_property
    def scores(self) -> Mapping[tuple[str, str, str, str], list[list[float]]]:
        """The rollouts of each run by the row's label, the task, the short variant and the rule."""
        table: dict[tuple[str, str, str, str], list[list[float]]] = {}
        for label, entries in self.items():
            for task, cells in (cell for run in entries for cell in by_variant(run.scores).items()):
                for variant, rule in product(cells, statistics.RULES):
                    rollouts = [getattr(row, rule) for row in cells[variant]]
                    table.setdefault((label, task, variant, rule), []).append(rollouts)
        return table

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks on which any run has scores, in order of first appearance."""
        return tuple(dict.fromkeys(task for _, task, *_ in self.scores))

    def on(self, task: str) -> dict[str, list[Entry]]:
        """The runs of each row that have a task."""
        runs = {label: [run for run in of if task in run.tasks] for label, of in self.items()}
        return {label: of for label, of in runs.items() if of}


def rows_of(entries: Iterable[Entry]) -> Rows:
    """The rows of tables of these entries."""
    return Rows(by_row(entries, lambda entry: entry))


class Statements(NamedTuple):
    """What the entries of one method state together."""

    demonstrations: str = ""  # how many and whose; empty if no entry says
    # How often test variants were evaluated while the method was designed: the largest number.
    test_evaluations: int | None = None

    @property
    def mark(self) -> str:
        """A dagger if test variants were evaluated before, otherwise empty."""
        return "†" if self.test_evaluations else ""


def gather_statements(entries: Iterable[Entry]) -> Statements:
    """The statements of a method's entries."""
    records = [entry.record for entry in entries]
    demonstrations = dict.fromkeys(r.demonstrations for r in records if r.demonstrations)
    numbers = [r.test_evaluations for r in records if r.test_evaluations is not None]
    return Statements("; ".join(demonstrations), max(numbers, default=None))


def marks(statements: Statements, track: str) -> str:
    """What follows a method's name in tables: † if tests were evaluated, its track in brackets."""
    return statements.mark + (f" [{track}]" if track else "")


def marked(label: str, runs: Sequence[Entry]) -> str:
    """A row's label: `with_conditions`, then its `marks`."""
    return with_conditions(label, runs) + marks(gather_statements(runs), track(runs))


def with_conditions(label: str, runs: Sequence[Entry]) -> str:
    """A row's label that says in parentheses if its runs see the state, or are unfinished."""
    found = ["sees the state"] if any(run.evaluated.privileged for run in runs) else []
    if parts := list(dict.fromkeys(filter(None, (run.record.unfinished for run in runs)))):
        found.append(f"unfinished: {', '.join(parts)}")
    return f"{label} ({'; '.join(found)})" if found else label


def track(runs: Sequence[Entry]) -> str:
    """The track of a row's entries together; empty if one does not state what it learned from."""
    stated = [run.record.learned_from for run in runs]
    if None in stated or any(run.evaluated.privileged for run in runs):
        return ""
    return track_of(name for names in stated for name in names or ())


class Cell(NamedTuple):
    """A mean score with its uncertainty."""

    mean: float
    detail: str
    difference: Interval | None = None  # from the published mean
    are_apart: bool = False  # few runs, some of which fail; `detail` lists them

    @property
    def lines(self) -> list[str]:
        """The mean, its uncertainty, the difference from the published mean and its interval."""
        more = [] if self.difference is None else signed(self.difference).split(" ", 1)
        return [decimals(self.mean), self.detail, *more]

    def __str__(self) -> str:
        """Text such as `0.88 ± 0.10 (−0.01)`, with the difference from the published mean."""
        value, detail, *more = self.lines
        return f"{value} {detail}" + (f" ({more[0]})" if more else "")


class Table(NamedTuple):
    """A table with a heading and a note on how to read it.

    Attributes:
        rows: each begins with its label; `ABSENT` stands where nothing was evaluated.
        row_notes: how to read the details of each row's cells, shown on pages.
        published: whether published rows are shown, and all scored by their rule.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    note: str = ""
    row_notes: Sequence[str] = ()
    published: bool = False

    @property
    def texts(self) -> list[list[str]]:
        """The rows as plain text."""
        return [list(map(str, row)) for row in self.rows]


def score_tables(rows: Rows, published: Sequence[str] = ()) -> list[Table]:
    """The tables of every task: by the appendix's rule, and by the published one if comparable.

    `published` are methods whose published rows are shown below. With them, all scores follow the
    published code's rule, and only rows with its horizon are shown. If a method has no such row,
    the published rows are left out, and the note says so. If the two rules and horizons are the
    same, one table shows both.
    """
    tables = []
    for task in map(get_task, rows.tasks):
        on_task = rows.on(task.name)  # all runs of a row have the same horizon
        methods = published if task.name in paper.published_tasks() else ()
        same = {label: runs for label, runs in on_task.items() if is_comparable(task, runs[0])}
        names = {runs[0].method for runs in same.values()}
        others = {_horizon(task, r[0]) for r in on_task.values() if r[0].method not in names}
        beside = bool(methods) and not others
        if not beside or _rules_differ(task) or len(same) < len(on_task):
            note = _rule_note(task, on_task, sorted(others) if methods else ())
            tables.append(_score_table(task, rows, on_task, note))
        if beside:
            tables.append(_score_table(task, rows, same, _published_note(task), methods))
    return tables


def _score_table(
    task: Task,
    rows: Rows,
    shown: Mapping[str, Sequence[Entry]],
    note: str,
    published: Sequence[str] = (),
) -> Table:
    """A row for each method on a task, then the published rows of the named methods."""
    variants, rule = list(map(short_variant, task.variants)), PUBLISHED_RULE if published else RULE
    changes = differences(task.name, rows, published)
    lines: list[list[str | Cell]] = []
    row_notes = []

    def add(label: str, cells: Mapping[str, Cell], row_note: str) -> None:
        if cells:
            lines.append([label, *(cells.get(variant, ABSENT) for variant in variants)])
            row_notes.append(row_note)

    for label, runs in shown.items():
        several = f"mean ± std over {len(runs)} runs"
        row_note = several if len(runs) > 1 else "mean, 95% interval over rollouts"
        method, change = changes.get(label, ("", {}))
        if change:
            exact = ", except on Demo, which is nudged" * any(run.evaluated.nudge for run in runs)
            row_note += f"; difference from {method}{exact}"
        cells = {
            variant: _cell(scores, len(runs), change.get(variant))
            for variant in variants
            if (scores := rows.scores.get((label, task.name, variant, rule)))
        }
        add(marked(label, runs), cells, row_note)
    for method in published:
        found = {variant: paper.published_score(task.name, method, variant) for variant in variants}
        cells = {v: Cell(each.mean, f"± {each.std:.2f}") for v, each in found.items() if each}
        add(f"{method}, published", cells, f"mean ± std over {paper.PUBLISHED_RUNS} runs")
    every = [cell for line in lines for cell in line if isinstance(cell, Cell)]
    note += BESIDE if any(cell.difference for cell in every) else ""
    note += ONE_RUN if any(len(runs) == 1 for runs in shown.values()) else ""
    note += MARKS if any(marked("", runs) for runs in shown.values()) else ""
    note += RUNS_APART if any(cell.are_apart for cell in every) else ""
    title = task.name + ", beside the published scores" * bool(published)
    return Table(title, [task.name, *variants], lines, note, row_notes, bool(published))


def _cell(runs: Sequence[list[float]], expected: int, difference: Interval | None) -> Cell:
    """A cell from each run's rollouts; says if fewer runs than expected have any."""
    few = "" if len(runs) == expected else f" ({len(runs)} of {expected} runs)"
    if len(runs) == 1:
        value, low, high = statistics.rollout_mean(runs[0])
        return Cell(value, f"[{low:.2f}, {high:.2f}]{few}", difference)
    value, std = statistics.over_runs(runs)
    listed = means_apart(np.mean(runs, axis=1).tolist())
    return Cell(value, f"± {std:.2f}{listed}{few}", difference, are_apart=bool(listed))


def _published_note(task: Task) -> str:
    """The scoring rule beside published rows."""
    if not _rules_differ(task):
        return "On this task, the published code's rule and horizon are the same as the appendix's."
    rule = "All rows are scored by the published code's rule, as the published ones are"
    steps = f", whose horizon is {task.published_horizon} control steps"
    return f"{rule}{steps * task.has_two_horizons}."


def _rule_note(task: Task, rows: Mapping[str, Sequence[Entry]], left_out: Sequence[int]) -> str:
    """The appendix's rule, rows with another horizon, and why published rows are left out.

    `left_out` are the horizons that differ from that of the published rows.
    """
    note = "Scored by the appendix's rule."
    horizons = {label: _horizon(task, runs[0]) for label, runs in rows.items()}
    if other := [f"{name} ({n})" for name, n in horizons.items() if n != task.horizon]:
        note += " Evaluated with another horizon than the appendix's "
        note += f"{task.horizon} control steps: {'; '.join(other)}."
    if left_out:
        theirs = task.resolve_horizon("published")
        note += f" The published rows are left out: their horizon is {theirs} control steps, not "
        asked = "published" if task.has_two_horizons else theirs
        note += f"{' or '.join(map(str, left_out))}; evaluate with --horizon {asked} to compare."
    return note


def _rules_differ(task: Task) -> bool:
    return task.published_score_fn is not None or task.has_two_horizons


def _horizon(task: Task, run: Entry) -> int:
    return task.resolve_horizon(run.evaluated.horizon)


def is_comparable(task: Task, run: Entry) -> bool:
    """Whether a run was evaluated with the horizon of the published rows of a task."""
    return _horizon(task, run) == task.resolve_horizon("published")


def matching_methods(entries: Iterable[Entry]) -> tuple[str, ...]:
    """The methods of the published tables that have the name of an entry's method."""
    names = {entry.method for entry in entries}
    return tuple(method for method in paper.published_methods() if method in names)


def differences(
    name: str, rows: Rows, published: Sequence[str]
) -> dict[str, tuple[str, dict[str, Interval]]]:
    """The published row that each row of a task is compared with, and by how much they differ.

    By the row's label, the published method, and our mean minus its by short variant name, where
    they can be compared. A method is compared with the published one of its name. If no method has
    the name of one of `published`, and there is only one, all are compared with that one.
    """
    on_task = rows.on(name)
    names = {label: runs[0].method for label, runs in on_task.items()}
    published = published if name in paper.published_tasks() else ()
    same = {label: method for label, method in names.items() if method in published}
    theirs = same or (dict.fromkeys(names, published[0]) if len(published) == 1 else {})
    return {
        label: (m, _differences(get_task(name), on_task[label], m)) for label, m in theirs.items()
    }


def _differences(task: Task, runs: Sequence[Entry], method: str) -> dict[str, Interval]:
    """As `differences`, of one row.

    Runs that see the state cannot be compared: all published rows see pixels. Demo scores of nudged
    runs cannot: the published ones are for the exact scene (docs/determinism.md).
    """
    if not all(is_comparable(task, run) and not run.evaluated.privileged for run in runs):
        return {}
    env_ids = [EnvId(task.name, variant) for variant in task.variants]
    means = statistics.run_means([run.scores for run in runs], env_ids, PUBLISHED_RULE)
    nudged = any(run.evaluated.nudge for run in runs)
    found = {}
    for variant, column in zip(map(short_variant, task.variants), means.T, strict=True):
        spread = paper.published_score(task.name, method, variant)
        if spread and not np.isnan(column).any() and not (nudged and variant == "Demo"):
            found[variant] = paper.difference_from_published(column, spread)
    return found


@dataclass(frozen=True)
class Method:
    """One method's runs in some environments, and their mean scores by the appendix's rule.

    Intervals are over runs. They are over rollouts (`OverRollouts`) if an environment has fewer
    than `FEWEST_RUNS` runs, if the runs do not differ, or if a run is the only one with its set of
    environments.
    """

    name: str  # with its marks
    runs: Sequence[Entry]
    env_ids: Sequence[EnvId]

    @cached_property
    def means(self) -> Floats:
        """(runs, environments); NaN where a run was not evaluated."""
        return statistics.run_means([run.scores for run in self.runs], self.env_ids)

    def on(self, env_ids: Sequence[EnvId]) -> "Method":
        """The same method on some of its environments, with the runs that have any of them."""
        runs = [run for run in self.runs if not set(env_ids).isdisjoint(run.evaluated.env_ids)]
        return Method(self.name, runs, env_ids)

    @property
    def fewest_runs(self) -> int:
        """The smallest number of runs in any environment."""
        return int((~np.isnan(self.means)).sum(axis=0).min())

    @property
    def unit(self) -> str:
        """What intervals are over, in words."""
        fewest, most = self.fewest_runs, int((~np.isnan(self.means)).sum(axis=0).max())
        count = f"{fewest}" if fewest == most else f"{fewest} to {most}"
        runs = f"{count} run{'s' if most > 1 else ''}"
        return runs if fewest >= FEWEST_RUNS else f"rollouts of {runs}"

    def mean(self) -> Interval:
        """The mean."""
        return self._interval(statistics.mean(self.means), self.equal_weights)

    def gap(self, variant: str = "TestAll") -> Interval | None:
        """The generalisation gap; `None` if no task has both Demo and the variant."""
        try:
            weights = statistics.gap_weights(self.env_ids, variant)
        except ValueError:
            return None
        found = statistics.generalisation_gap(self.means, self.env_ids, variant)
        return self._interval(found, weights)

    def interquartile_mean(self) -> Interval:
        """The interquartile mean; without bounds where the interval would not be over runs."""
        found = statistics.interquartile_mean(self.means)
        return found if self.fewest_runs >= FEWEST_RUNS else Interval(found.value, np.nan, np.nan)

    def difference(self, other: "Method") -> Interval:
        """This method's mean minus another's; over runs if both means are."""
        means = [self.mean(), other.mean()]
        if any(isinstance(each, OverRollouts) for each in means):
            return OverRollouts(*statistics.weighted_sum(means, [1.0, -1.0]))
        return statistics.difference(self.means, other.means)

    @property
    def equal_weights(self) -> Floats:
        """(environments,): those of the mean."""
        return np.full(len(self.env_ids), 1 / len(self.env_ids))

    def _interval(self, over_runs: Interval, weights: Floats) -> Interval:
        """The interval over runs, or over rollouts for too few runs, or if it has no bounds."""
        if self.fewest_runs >= FEWEST_RUNS and not math.isnan(over_runs.low):
            return over_runs
        return statistics.over_rollouts([run.scores for run in self.runs], self.env_ids, weights)

    def apart(self, weights: Floats | None = None) -> str:
        """The means of runs on the same environments where a few differ much, with their tasks."""
        weights = self.equal_weights if weights is None else weights
        strata = group_by(
            self.means, lambda run: tuple(np.flatnonzero(~np.isnan(run) * weights).tolist())
        )
        texts = []
        for columns in map(list, filter(None, strata)):
            share = weights[columns].clip(min=0.0).sum()
            runs = strata[tuple(columns)]
            listed = means_apart([float(run[columns] @ weights[columns] / share) for run in runs])
            tasks = ", ".join(dict.fromkeys(self.env_ids[column].task for column in columns))
            texts += [listed.replace("(", f"({tasks}: ") if len(strata) > 1 else listed]
        return "".join(texts)


def compared_methods(rows: Rows) -> list[Method]:
    """Every method on the environments that all of them have; empty if there are none.

    Evaluations that differ are compared like methods. A row's runs are each on all of its tasks or
    on some; it has an environment if all its runs on that task do, so a mean over environments is
    over the same ones for all runs of a task.
    """
    found = [_environments(runs) for runs in rows.values()]
    shared = [env_id for env_id in (found[0] if found else []) if all(env_id in i for i in found)]
    made = [Method(marked(label, runs), runs, shared) for label, runs in rows.items()]
    return [method.on(shared) for method in made] if shared else []


def _environments(runs: Sequence[Entry]) -> list[EnvId]:
    """The environments that all of a method's runs on their task have, in order of appearance."""
    known = dict.fromkeys(env_id for run in runs for env_id in run.evaluated.env_ids)
    return [i for i in known if all(i in r.evaluated.env_ids for r in runs if i.task in r.tasks)]


def summary_tables(rows: Rows) -> list[Table]:
    """The methods over all environments that they have in common, then their gaps, if any.

    All but the first are compared with the first; environments that are left out are named.
    """
    methods = compared_methods(rows)
    if not methods:
        return []
    first, *others = methods
    header = ["method", "intervals over", "mean", "interquartile mean", "generalisation gap"]
    header += [f"difference from {first.name}"] if others else []
    lines = []
    for method in methods:
        text = interval_text(method.mean(), method.unit) + method.apart()
        line = [method.name, method.unit, text]
        line += [interval_text(method.interquartile_mean()), gap_text(method)]
        if method is not first:
            line.append(interval_text(method.difference(first), method.unit))
        elif others:
            line.append(ABSENT)
        lines.append(line)
    count = len(first.env_ids)
    known = dict.fromkeys(
        i for runs in rows.values() for run in runs for i in run.evaluated.env_ids
    )
    names = [f"{i.task} {short_variant(i.variant)}" for i in known if i not in first.env_ids]
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    left = " Left out because not all runs and methods have them: "
    note = f"Over {count} environment{'s' if count != 1 else ''}."
    note += f"{left}{', '.join(names[:SHOWN])}{more}." if names else ""
    note += f" {INTERVALS}{MARKS}"
    note += RUNS_APART if any(method.apart() for method in methods) else ""
    tables = [Table("All environments", header, lines, note)]
    axes = [short for short in SHORT_VARIANTS[1:] if first.gap(full_variant(short)) is not None]
    if axes:
        lines = [[m.name, *(gap_text(m, full_variant(axis)) for axis in axes)] for m in methods]
        tables.append(Table("Generalisation gaps", ["method", *axes], lines, GAPS))
    return tables


def gap_text(method: Method, variant: str = "TestAll") -> str:
    """The generalisation gap, and those of runs where a few of them differ much."""
    if (gap := method.gap(variant)) is None:
        return ABSENT
    return interval_text(gap, method.unit) + method.apart(
        statistics.gap_weights(method.env_ids, variant)
    )


def interval_text(interval: Interval, unit: str = "rollouts") -> str:
    """An interval as text; without brackets if there is only the estimate.

    `unit` is what the row's intervals are said to be over; an interval over rollouts in a row over
    runs says so.
    """
    value, low, high = map(decimals, interval)
    return value if math.isnan(interval.low) else f"{value} [{low}, {high}]{over(interval, unit)}"


def over(interval: Interval, unit: str) -> str:
    """` over rollouts` for such an interval in a row over runs; otherwise empty."""
    differs = isinstance(interval, OverRollouts) and not unit.startswith("rollouts")
    return " over rollouts" if differs else ""


def signed(interval: Interval) -> str:
    """A difference with its interval, as text: `+0.02 [−0.10, +0.14]`."""
    value, low, high = (decimals(number, sign="+") for number in interval)
    return value if math.isnan(interval.low) else f"{value} [{low}, {high}]"


def means_apart(means: Sequence[float]) -> str:
    """A few runs' means, such as ` (1.00, 0.00, 0.75)`, if some succeed and some fail."""
    if len(means) > FEW or max(means) - min(means) <= APART:
        return ""
    return f" ({', '.join(f'{value:.2f}' for value in means)})"


def format_of(path: Path) -> str:
    """The format for a file's suffix, HTML if it has none; raises `UnknownNameError`."""
    kind = SUFFIXES.get(path.suffix.lower() or ".html")
    if kind is None:
        raise UnknownNameError(f"{path}: expected the suffix {', '.join(SUFFIXES)}, or --format")
    return kind


def all_tables(rows: Rows, published: Sequence[str]) -> list[Table]:
    """All tables of a page."""
    return [*score_tables(rows, published), *summary_tables(rows)]


def write_tables(kind: str, rows: Rows, published: Sequence[str], path: Path) -> None:
    """Write the rows of `plain_rows` as `csv`, numbers to `DIGITS` digits, or all as `markdown`."""
    if kind == "markdown":
        write_text(path, "\n".join(map(markdown, all_tables(rows, published))))
        return
    text, lines = io.StringIO(), plain_rows(rows, published)
    writer = csv.DictWriter(text, lines[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _csv_text(value) for name, value in line.items()} for line in lines)
    write_text(path, text.getvalue())


def _csv_text(value: float | str | None) -> str:
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{value}"  # a name that a spreadsheet would take for a formula
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    return "" if value is None else str(value)


def markdown(table: Table) -> str:
    """A table in Markdown, with its heading and note."""

    def escaped(text: str) -> str:
        return re.sub(r"([\\|`*_<>\[\]])", r"\\\1", text)

    rows = [table.header, ["---"] * len(table.header), *table.texts]
    lines = [f"| {' | '.join(map(escaped, row))} |" for row in rows]
    return "\n".join([f"## {escaped(table.title)}", "", *lines, "", escaped(table.note), ""])


def plain_rows(rows: Rows, published: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each method and environment, as plain data; `None` for missing values.

    `score` and its interval follow the appendix's rule, `published_code_score` and the difference
    follow the published code's. The last columns say how the environment was evaluated.
    """
    return [row for name in rows.tasks for row in _plain_rows(name, rows, published)]


def _plain_rows(name: str, rows: Rows, published: Sequence[str]) -> Iterator[dict[str, Any]]:
    """A row for each method and variant of a task, by column name."""
    compared = differences(name, rows, published)
    for label, runs in rows.on(name).items():
        theirs, changes = compared.get(label, (None, {}))
        how = runs[0].evaluated  # the same for all runs of a row, but for environments
        horizon = get_task(name).resolve_horizon(how.horizon)
        for variant in dict.fromkeys(key[2] for key in rows.scores if key[:2] == (label, name)):
            scores, published_code_scores = (
                np.mean(rows.scores[label, name, variant, rule], axis=1)  # (runs,)
                for rule in statistics.RULES
            )
            interval = Method("", runs, ()).on([EnvId(name, full_variant(variant))]).mean()
            change = changes.get(variant)
            spread = paper.published_score(name, theirs, variant) if theirs and change else None
            numbers = {
                "score": interval.value,
                "score_std": float(np.std(scores)) if len(scores) > 1 else None,
                "score_low": interval.low,
                "score_high": interval.high,
                PUBLISHED_RULE: float(np.mean(published_code_scores)),
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
                "test_evaluations": gather_statements(runs).test_evaluations,
                **how.settings,
                "horizon": horizon,
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
        record_reels(found.results, load_policy, clips) if load_policy and clips else ({}, [])
    )
    rows = rows_of(found.entries)
    curves, damaged = curves_by_task(found.results)
    skipped = [(str(item.folder), item.reason) for item in found.skipped]
    skipped += [(str(folder), reason) for folder, reason in damaged.items()]
    evaluated = {env_id.variant for run in found.entries for env_id in run.evaluated.env_ids}
    counts = {entry.evaluated.rollouts for entry in found.entries}
    html = render_template(
        "page.html.j2",
        title=title,
        runs=len(found.results),
        methods=len({entry.method for entry in found.entries}),
        conclusions=conclusions,
        changed={short_variant(v): text for v, text in CHANGED.items() if v in evaluated},
        tables=score_tables(rows, published),
        rollouts=" to ".join(map(str, sorted({min(counts), max(counts)}))),
        summaries=summary_tables(rows),
        curves=curves,
        reels=reels,
        clip_notes=notes,
        skipped=skipped,
        version=__version__,
    )
    write_text(path, html)
    return () if reels else notes


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
