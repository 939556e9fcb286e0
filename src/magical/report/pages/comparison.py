"""A page that compares two methods."""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

from magical.errors import UnknownNameError
from magical.evaluation.intervals import Interval
from magical.evaluation.statistics import probability_of_improvement
from magical.grouping import group_by
from magical.messages import decimals
from magical.report.figures.plots import interval_plot, profile_plot
from magical.report.found.facts import MethodFacts, describe_rows
from magical.report.found.rows import by_row
from magical.report.found.search import Result
from magical.report.pages.page import Figure, render_template, write_text
from magical.report.scores.methods import ComparedMethod, compared_rows
from magical.report.scores.summaries import (
    AXES,
    NOTE,
    THRESHOLDS,
    gap_table,
    interval_text,
    mean_text,
    over,
    profiles,
)
from magical.report.scores.tables import RUNS_APART, TextTable, signed
from magical.tasks.axes import short_variant


@dataclass(frozen=True, slots=True)
class ComparisonPage:
    """The content of a page about the difference between two methods."""

    headline: str
    tables: Sequence[TextTable]
    overall: dict[str, Interval]  # differences of means: all together, by task and by variant
    methods: Sequence[ComparedMethod]
    described: Sequence[MethodFacts]

    def write(self, path: Path | str) -> None:
        """Write the page, with everything inline; raises `OSError` if it cannot be written."""
        label = f"mean score of {self.methods[0].name} minus that of {self.methods[1].name}"
        figures = [
            Figure(
                interval_plot(self.overall, label, "difference", zero=True),
                "Differences of means with 95% intervals: right of 0, the first method is better.",
            ),
            Figure(
                profile_plot(THRESHOLDS, profiles(self.methods)),
                "Performance profiles: the share of runs, averaged over environments, that score "
                "above τ.",
            ),
        ]
        write_text(path, render_template("comparison.html.j2", page=self, figures=figures))


def compare(results: Sequence[Result], first: str, second: str) -> ComparisonPage:
    """Compare two methods on the environments that both have, with the appendix's scoring rule.

    Raises `UnknownNameError` if a method is unknown, both are the same, or they have no environment
    in common.
    """
    if first == second:
        raise UnknownNameError(f"--compare: expected two different methods, found {first!r} twice")
    chosen = {name: _of_method(results, name) for name in (first, second)}
    methods = compared_rows({name: [run.entry for run in runs] for name, runs in chosen.items()})
    if len(methods) < 2:
        raise UnknownNameError(
            f"--compare: expected two methods with an environment in common, found none for "
            f"{first!r} and {second!r}"
        )
    described = describe_rows(chosen)
    tables = [_summary(*methods), gap_table(methods), _environments(*methods), _settings(described)]
    return ComparisonPage(
        _headline(*methods),
        [table for table in tables if table],
        _differences(*methods),
        methods,
        described,
    )


def _of_method(results: Sequence[Result], name: str) -> list[Result]:
    rows = by_row(results, attrgetter("entry"))
    if name not in rows:
        known = ", ".join(rows)
        raise UnknownNameError(f"--compare: method {name!r} is unknown; expected one of: {known}")
    return rows[name]


def _headline(first: ComparedMethod, second: ComparedMethod) -> str:
    """The difference in words."""
    found = first.difference(second)
    count = len(first.env_ids)
    text = (
        f"Over {count} environment{'s' if count != 1 else ''}, the mean score of {first.name} is "
        f"{decimals(abs(found.value))} {'higher' if found.value >= 0 else 'lower'} than that of "
        f"{second.name} ({_difference_text(first, second)})."
    )
    if found.low <= 0.0 <= found.high:
        return f"{text} The interval contains 0, so this does not show which is better."
    return text


def _summary(first: ComparedMethod, second: ComparedMethod) -> TextTable:
    better = probability_of_improvement(first.means, second.means)
    rows = [
        ("runs", first.unit, second.unit, ""),
        (
            "mean",
            mean_text(first),
            mean_text(second),
            _difference_text(first, second),
        ),
        (
            "interquartile mean",
            interval_text(first.interquartile_mean()),
            interval_text(second.interquartile_mean()),
            "",
        ),
        (f"P({first.name} better)", "", "", interval_text(better)),
    ]
    note = NOTE + (RUNS_APART if first.means_apart() or second.means_apart() else "")
    return TextTable("Summary", ("", first.name, second.name, "difference"), rows, note)


def _difference_text(first: ComparedMethod, second: ComparedMethod) -> str:
    found = first.difference(second)
    unit = next((m.unit for m in (first, second) if not m.over_runs), first.unit)
    return signed(found) + over(found, unit)


def _environments(first: ComparedMethod, second: ComparedMethod) -> TextTable:
    pairs = [(i, first.on([i]), second.on([i])) for i in first.env_ids]
    rows = [
        (
            *(env_id.task, short_variant(env_id.variant)),
            *(mean_text(a), mean_text(b), _difference_text(a, b)),
        )
        for env_id, a, b in pairs
    ]
    header = ("task", "variant", first.name, second.name, "difference")
    return TextTable("Environment by environment", header, rows, "95% intervals, as above.")


def _differences(first: ComparedMethod, second: ComparedMethod) -> dict[str, Interval]:
    """The difference of means over all environments, by task, and by variant."""
    env_ids = first.env_ids
    groups = {"all": list(env_ids), **group_by(env_ids, attrgetter("task"))}
    variants = group_by(env_ids, attrgetter("variant"))
    for variant in ("Demo", *AXES):
        if variant in variants:
            name = short_variant(variant) if variant != "TestAll" else "All (variant)"
            groups[name] = variants[variant]
    return {
        name: first.on(members).difference(second.on(members)) for name, members in groups.items()
    }


def _settings(described: Sequence[MethodFacts]) -> TextTable | None:
    """Settings that the runs of each method share but in which the two methods differ."""
    a, b = (method.common for method in described)
    names = [name for name in {**a, **b} if a.get(name) != b.get(name)]
    rows = [(name, a.get(name, "–"), b.get(name, "–")) for name in names]
    header = ("setting", *(method.method for method in described))
    note = "Settings that all runs of a method have in common; a dash where they have none."
    return TextTable("Settings that differ", header, rows, note) if rows else None
