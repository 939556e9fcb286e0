"""The table behind all reports, and what is read from it: cells, differences, means.

`tabulate` makes a record (method, task, variant, run, rule, score) of each run's mean score in an
environment. The score tables of a page, the rows of a CSV file and the leaderboard are made of it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from magical.envs import EnvId
from magical.evaluation import (
    Entry,
    by_variant,
    difference_from_published,
    published_methods,
    published_score,
    published_tasks,
)
from magical.evaluation.published import PUBLISHED_RUNS
from magical.evaluation.statistics import (
    FEWEST_RUNS,
    RULES,
    Floats,
    Interval,
    OverRollouts,
    difference,
    gap_weights,
    generalisation_gap,
    interquartile_mean,
    mean,
    over_rollouts,
    over_runs,
    rollout_mean,
    weighted_sum,
)
from magical.grouping import group_by
from magical.messages import decimals
from magical.report.found import by_row
from magical.runs import track_of
from magical.tasks import Task, get_task
from magical.tasks.axes import SHORT_VARIANTS, full_variant, short_variant

RULE, PUBLISHED_RULE = RULES
APART, FEW = 0.5, 5  # at most FEW runs whose means are more than APART apart are listed singly
MARKS = (
    " After a method's name, † says that test variants were evaluated while it was designed, and "
    "the letter in brackets is its track (docs/protocol.md)."
)
ONE_RUN = (
    " In brackets: 95% intervals over the rollouts of one run, which do not include the spread "
    "between training runs."
)
BESIDE = " In parentheses: the difference from the published mean."
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
SHOWN = 6  # environments named in a note


class Score(NamedTuple):
    """A run's mean score in an environment by a rule."""

    method: str  # the label of the row
    task: str
    variant: str  # short
    run: int  # number of the run in its row
    rule: str
    score: float
    rollouts: Sequence[float]


class Rows(dict[str, list[Entry]]):
    """The runs of each row of tables, by its label, and the table of their scores."""

    @cached_property
    def scores(self) -> Mapping[tuple[str, str, str, str], list[Score]]:
        """The scores of each method, task, variant and rule, in the order of the runs."""
        return group_by(tabulate(self), lambda score: (*score[:3], score.rule))

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks on which any run has scores, in order of first appearance."""
        return tuple(dict.fromkeys(score[1] for score in self.scores))

    def on(self, task: str) -> "Rows":
        """The rows with a task, each with the runs that have it."""
        runs = {label: [run for run in of if task in run.tasks] for label, of in self.items()}
        return Rows({label: of for label, of in runs.items() if of})


def tabulate(rows: Mapping[str, Sequence[Entry]]) -> list[Score]:
    """A record of each run, environment and rule."""
    return [
        Score(label, task, variant, run, rule, float(np.mean(values)), values)
        for label, entries in rows.items()
        for run, entry in enumerate(entries)
        for task, cells in by_variant(entry.scores).items()
        for variant, cell in cells.items()
        for rule in RULES
        for values in [[getattr(row, rule) for row in cell]]
    ]


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


@dataclass(frozen=True, slots=True)
class Cell:
    """A mean score with its uncertainty."""

    mean: float
    detail: str
    difference: Interval | None = None  # from the published mean
    are_apart: bool = False  # few runs, some of which fail; `detail` lists them

    @property
    def text(self) -> str:
        """Text such as `0.88 ± 0.10 (−0.01)`, with the difference from the published mean."""
        beside = f" ({self.beside[0]})" if self.beside else ""
        return f"{decimals(self.mean)} {self.detail}{beside}"

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
        title = self.task + ", beside the published scores" * self.published
        cells = [[row.cells.get(variant) for variant in self.variants] for row in self.rows]
        texts = [[cell.text if cell else "–" for cell in line] for line in cells]
        rows = [(row.label, *line) for row, line in zip(self.rows, texts, strict=True)]
        return TextTable(title, (self.task, *self.variants), rows, self.note)


def score_tables(rows: Rows, published: Sequence[str] = ()) -> list[ScoreTable]:
    """The tables of every task: by the appendix's rule, and by the published one if comparable.

    If the two rules and horizons are the same, one table shows both.
    """
    tables = []
    for name in rows.tasks:
        beside, task = task_table(name, rows, published), get_task(name)
        all_shown = all(is_comparable(task, run) for runs in rows.on(name).values() for run in runs)
        if beside.published and (_rules_differ(task) or not all_shown):
            tables.append(task_table(name, rows))
        tables.append(beside)
    return tables


def task_table(name: str, rows: Rows, published: Sequence[str] = ()) -> ScoreTable:
    """A row for each method on a task, then the published rows of the named methods.

    With published rows, all scores follow the published code's rule, and only rows with the
    published code's horizon are shown. If a method has no such row, the published rows are left
    out, and the note says so.
    """
    task, table = get_task(name), rows.scores
    rows = rows.on(name)
    methods = tuple(published) if name in published_tasks() else ()
    theirs = counterparts(rows, methods)
    first = [runs[0] for runs in rows.values()]  # all runs of a row have the same horizon
    comparable = {entry.method for entry in first if is_comparable(task, entry)}
    other = sorted({horizon_of(task, run) for run in first if run.method not in comparable})
    compared = bool(methods) and not other
    made = [
        _row(task, label, runs, table, theirs if compared else None)
        for label, runs in rows.items()
        if not compared or is_comparable(task, runs[0])
    ]
    if compared:
        spread = f"mean ± std over {PUBLISHED_RUNS} runs"
        for method in methods:
            found = {v: published_score(name, method, v) for v in SHORT_VARIANTS}
            theirs_cells = {v: Cell(s.mean, f"± {s.std:.2f}") for v, s in found.items() if s}
            made.append(Row(f"{method}, published", theirs_cells, spread))
    kept = tuple(row for row in made if row.cells)
    cells = [cell for row in kept for cell in row.cells.values()]
    note = _rule_note(task, compared, rows)
    note += _left_out_note(task, other) if methods and other else ""
    note += BESIDE if any(cell.difference for cell in cells) else ""
    note += ONE_RUN if any(len(runs) == 1 for runs in rows.values()) else ""
    note += MARKS if any(marked("", runs) for runs in rows.values()) else ""
    note += RUNS_APART if any(cell.are_apart for cell in cells) else ""
    return ScoreTable(name, tuple(map(short_variant, task.variants)), kept, note, compared)


def _row(
    task: Task,
    label: str,
    runs: Sequence[Entry],
    table: Mapping[tuple[str, str, str, str], list[Score]],
    theirs: Mapping[str, str] | None,
) -> Row:
    """A method's row, by the appendix's rule, or beside its published counterpart if given."""
    rule = RULE if theirs is None else PUBLISHED_RULE
    found = {v: table.get((label, task.name, v, rule), []) for v in SHORT_VARIANTS}
    cells = {variant: _cell(scores, len(runs)) for variant, scores in found.items() if scores}
    note = (
        f"mean ± std over {len(runs)} runs" if len(runs) > 1 else "mean, 95% interval over rollouts"
    )
    method = (theirs or {}).get(runs[0].method)
    if method and (changes := differences(task, runs, method)):
        cells = {v: replace(cell, difference=changes.get(v)) for v, cell in cells.items()}
        exact = ", except on Demo, which is nudged" * any(run.evaluated.nudge for run in runs)
        note = f"{note}; difference from {method}{exact}"
    return Row(marked(label, runs), cells, note)


def _cell(runs: Sequence[Score], expected: int) -> Cell:
    """A cell from each run's score; says if fewer runs than expected have any."""
    few = "" if len(runs) == expected else f" ({len(runs)} of {expected} runs)"
    if len(runs) > 1:
        mean, std = over_runs([[run.score] for run in runs])
        listed = means_apart([run.score for run in runs])
        return Cell(mean, f"± {std:.2f}{listed}{few}", are_apart=bool(listed))
    value, low, high = rollout_mean(runs[0].rollouts)
    return Cell(value, f"[{low:.2f}, {high:.2f}]{few}")


def _rule_note(task: Task, published: bool, rows: Rows) -> str:
    """The scoring rule, and the rows whose horizon differs from the rule's."""
    if published and not _rules_differ(task):
        return "On this task, the published code's rule and horizon are the same as the appendix's."
    if published:
        horizon = f", whose horizon is {task.published_horizon} control steps"
        return (
            "All rows are scored by the published code's rule, as the published ones are"
            f"{horizon * task.has_two_horizons}."
        )
    steps = {label: horizon_of(task, runs[0]) for label, runs in rows.items()}
    other = [f"{label} ({number})" for label, number in steps.items() if number != task.horizon]
    if not other:
        return "Scored by the appendix's rule."
    return (
        "Scored by the appendix's rule. Evaluated with another horizon than the appendix's "
        f"{task.horizon} control steps: {'; '.join(other)}."
    )


def _rules_differ(task: Task) -> bool:
    return task.published_score_fn is not None or task.has_two_horizons


def _left_out_note(task: Task, other: Sequence[int]) -> str:
    """Why published rows are left out: the horizons that differ from theirs."""
    steps = task.resolve_horizon("published")
    asked = "published" if task.has_two_horizons else steps
    return (
        f" The published rows are left out: their horizon is {steps} control "
        f"steps, not {' or '.join(map(str, other))}; evaluate with --horizon {asked} to compare."
    )


def horizon_of(task: Task, run: Entry) -> int:
    """The horizon, in control steps, that a run was evaluated with on a task."""
    return task.resolve_horizon(run.evaluated.horizon)


def is_comparable(task: Task, run: Entry) -> bool:
    """Whether a run was evaluated with the horizon of the published rows of a task."""
    return horizon_of(task, run) == task.resolve_horizon("published")


def matching_methods(entries: Iterable[Entry]) -> tuple[str, ...]:
    """The methods of the published tables that have the name of an entry's method."""
    names = {entry.method for entry in entries}
    return tuple(method for method in published_methods() if method in names)


def counterparts(rows: Rows, published: Sequence[str]) -> dict[str, str]:
    """The published row that each method is compared with: the one of the same name.

    If no method has the name of a published row, and there is only one such row, all methods are
    compared with that one.
    """
    names = [runs[0].method for runs in rows.values()]
    same = {name: name for name in names if name in published}
    return same or (dict.fromkeys(names, published[0]) if len(published) == 1 else {})


def differences(task: Task, runs: Sequence[Entry], method: str) -> Mapping[str, Interval]:
    """Our mean minus the published one, by short variant name, where they can be compared.

    Runs that see the state cannot: all published rows see pixels. Demo scores of nudged runs
    cannot: the published ones are for the exact scene (docs/determinism.md).
    """
    if not all(is_comparable(task, run) and not run.evaluated.privileged for run in runs):
        return {}
    table = group_by(
        (s for s in tabulate({"": runs}) if s.rule == PUBLISHED_RULE and s.task == task.name),
        lambda score: score.variant,
    )
    nudged = any(run.evaluated.nudge for run in runs)
    found = {}
    for variant, scores in table.items():
        spread = published_score(task.name, method, variant)
        if spread and len(scores) == len(runs) and not (nudged and variant == "Demo"):
            found[variant] = difference_from_published([score.score for score in scores], spread)
    return found


@dataclass(frozen=True)
class Method:
    """One method's runs in some environments, and their mean scores by the appendix's rule."""

    name: str  # with its marks
    runs: Sequence[Entry]
    env_ids: Sequence[EnvId]

    @cached_property
    def means(self) -> Floats:
        """(runs, environments); NaN where a run was not evaluated."""
        places = {(i.task, short_variant(i.variant)): n for n, i in enumerate(self.env_ids)}
        means = np.full((len(self.runs), len(places)), np.nan)
        for score in tabulate({"": self.runs}):
            place = places.get((score.task, score.variant))
            if place is not None and score.rule == RULE:
                means[score.run, place] = score.score
        return means

    def on(self, env_ids: Sequence[EnvId]) -> "Method":
        """The same method on some of its environments, with the runs that have any of them."""
        wanted = set(env_ids)
        runs = [run for run in self.runs if not wanted.isdisjoint(run.evaluated.env_ids)]
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
        """The mean, with an interval over runs.

        It is over rollouts (`OverRollouts`) if an environment has fewer than `FEWEST_RUNS` runs, if
        the runs do not differ, or if a run is the only one with its set of environments.
        """
        return self._shown(mean(self.means)) or self._over_rollouts(self.equal_weights)

    def gap(self, variant: str = "TestAll") -> Interval | None:
        """The generalisation gap, as `mean`; `None` if no task has both Demo and the variant."""
        try:
            weights = gap_weights(self.env_ids, variant)
        except ValueError:
            return None
        found = generalisation_gap(self.means, self.env_ids, variant)
        return self._shown(found) or self._over_rollouts(weights)

    def interquartile_mean(self) -> Interval:
        """The interquartile mean; without bounds where the interval would not be over runs."""
        found = interquartile_mean(self.means)
        return self._shown(found) or Interval(found.value, np.nan, np.nan)

    def difference(self, other: "Method") -> Interval:
        """This method's mean minus another's; over runs if both means are."""
        means = [self.mean(), other.mean()]
        if any(isinstance(each, OverRollouts) for each in means):
            return OverRollouts(*weighted_sum(means, [1.0, -1.0]))
        return difference(self.means, other.means)

    @property
    def equal_weights(self) -> Floats:
        """(environments,): those of the mean."""
        return np.full(len(self.env_ids), 1 / len(self.env_ids))

    def _shown(self, found: Interval) -> Interval | None:
        """An interval over runs; `None` for too few runs, or if it has no bounds."""
        return found if self.fewest_runs >= FEWEST_RUNS and not math.isnan(found.low) else None

    def _over_rollouts(self, weights: Floats) -> OverRollouts:
        return over_rollouts([run.scores for run in self.runs], self.env_ids, weights)

    def apart(self, weights: Floats | None = None) -> str:
        """The means of runs on the same environments where a few differ much, with their tasks."""
        weights = self.equal_weights if weights is None else weights
        strata = group_by(
            self.means, lambda run: tuple(np.flatnonzero(~np.isnan(run) * weights).tolist())
        )
        texts = []
        for places, runs in strata.items():
            if not places:
                continue
            columns = list(places)
            share = weights[columns].clip(min=0.0).sum()
            listed = means_apart([float(run[columns] @ weights[columns] / share) for run in runs])
            tasks = ", ".join(dict.fromkeys(self.env_ids[place].task for place in columns))
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
    found = [set(run.evaluated.env_ids) for run in runs]
    known = dict.fromkeys(env_id for run in runs for env_id in run.evaluated.env_ids)
    tasks = {i.task: [ids for ids in found if i.task in {j.task for j in ids}] for i in known}
    return [env_id for env_id in known if all(env_id in ids for ids in tasks[env_id.task])]


def summary_tables(rows: Rows) -> list[TextTable]:
    """The methods over all environments that they have in common, then their gaps, if any.

    All but the first are compared with the first; environments that are left out are named.
    """
    methods = compared_methods(rows)
    if not methods:
        return []
    first, *others = methods
    header: tuple[str, ...] = (
        "method",
        "intervals over",
        "mean",
        "interquartile mean",
        "generalisation gap",
    )
    lines: list[tuple[str, ...]] = [
        (
            method.name,
            method.unit,
            interval_text(method.mean(), method.unit) + method.apart(),
            interval_text(method.interquartile_mean()),
            gap_text(method),
            *([interval_text(method.difference(first), method.unit)] if method in others else []),
        )
        for method in methods
    ]
    if others:
        header = (*header, f"difference from {first.name}")
        lines[0] = (*lines[0], "–")
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
    tables = [TextTable("All environments", header, lines, note)]
    axes = [full_variant(v) for v in SHORT_VARIANTS if v != "Demo"]
    if axes := [axis for axis in axes if first.gap(axis) is not None]:
        lines = [(method.name, *(gap_text(method, axis) for axis in axes)) for method in methods]
        note = (
            "The mean score on Demo minus that on the variant, by task, averaged over the tasks "
            "that have the variant: the larger, the worse the method generalises along that axis. "
            "Intervals as above."
        )
        header = ("method", *map(short_variant, axes))
        tables.append(TextTable("Generalisation gaps", header, lines, note))
    return tables


def gap_text(method: Method, variant: str = "TestAll") -> str:
    """The generalisation gap, and those of runs where a few of them differ much."""
    if (gap := method.gap(variant)) is None:
        return "–"
    return interval_text(gap, method.unit) + method.apart(gap_weights(method.env_ids, variant))


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
