"""Methods over all environments and along each axis."""

import math

import pytest

from magical.envs import EnvId
from magical.evaluation import Entry
from magical.evaluation.statistics import OverRollouts, gap_weights
from magical.report.table import (
    RUNS_APART,
    Method,
    TextTable,
    compared_methods,
    rows_of,
    summary_tables,
)
from tests.report.conftest import make_entry

NAMES = {
    "line": "MakeLine-Demo",
    "line_jitter": "MakeLine-TestJitter",
    "line_all": "MakeLine-TestAll",
    "dupe": "FindDupe-Demo",
    "dupe_all": "FindDupe-TestAll",
}
DEMO = EnvId("MakeLine", "Demo")
T2, T4 = 4.302653, 2.776445  # 97.5% quantiles of Student's t


def entry(method: str, **scores: list[float]) -> Entry:
    return make_entry(method, {NAMES[name]: values for name, values in scores.items()})


def compared(entries: list[Entry]) -> tuple[list[Method], TextTable]:
    rows = rows_of(entries)
    return compared_methods(rows), summary_tables(rows)[0]


def test_one_run_each_is_compared_over_rollouts() -> None:
    first = entry("first", line=[0.0, 0.0, 0.5, 1.0], dupe=[0.0] * 4)
    second = entry("second", line=[1.0] * 4, dupe=[0.0] * 4)
    rows, grid = compared([first, second])
    assert grid.note.startswith("Over 2 environments.")
    assert "do not include the spread between training runs" in grid.note
    assert [row.unit for row in rows] == ["rollouts of 1 run"] * 2
    assert rows[0].mean().value == pytest.approx(1.5 / 8)
    assert rows[0].mean().low < 1.5 / 8 < rows[0].mean().high
    assert rows[1].difference(rows[0]).value == pytest.approx(0.5 - 1.5 / 8)
    # The interquartile mean; no comparison with itself.
    assert grid.rows[0][3:] == ("0.19", "–", "–")
    assert [cell.split()[0] for cell in grid.rows[1][4:]] == ["–", "0.31"]


def test_several_runs_each_are_compared_over_runs() -> None:
    runs = [entry("a", line=[*pair]) for pair in ((0.2, 0.4), (0.4, 0.4), (0.5, 0.5))]
    others = [entry("b", line=[score]) for score in (0.4, 0.5, 0.6)]
    rows, _grid = compared([*runs, *others])
    half = T2 * 0.1 / math.sqrt(3)
    assert [row.unit for row in rows] == ["3 runs"] * 2
    assert rows[0].mean() == pytest.approx((0.4, 0.4 - half, 0.4 + half))
    half = T4 * math.sqrt(2 * 0.01 / 3)
    assert rows[1].difference(rows[0]) == pytest.approx((0.1, 0.1 - half, 0.1 + half))


def test_a_method_with_one_run_leaves_others_their_intervals_over_runs() -> None:
    runs = [entry("a", line=[score]) for score in (0.3, 0.4, 0.5)]
    rows, _table = compared([*runs, entry("b", line=[0.0, 1.0])])
    assert [row.unit for row in rows] == ["3 runs", "rollouts of 1 run"]
    below = math.hypot(rows[1].mean().value - rows[1].mean().low, rows[0].mean().high - 0.4)
    assert rows[1].difference(rows[0]).low == pytest.approx(0.1 - below)


def test_runs_of_single_tasks_are_strata_and_those_of_several_tasks_are_not() -> None:
    line = [entry("single", line=[score]) for score in (0.3, 0.4, 0.5)]
    dupe = [entry("single", dupe=[score]) for score in (0.5, 0.6, 0.7)]
    multi = [entry("multi", line=[s], dupe=[s + 0.2]) for s in (0.3, 0.4, 0.5)]
    rows, _table = compared([*line, *dupe, *multi])
    assert [row.unit for row in rows] == ["3 runs", "3 runs"]
    half = T4 * math.sqrt(2 * 0.01 / 3) / 2
    assert rows[0].mean() == pytest.approx((0.5, 0.5 - half, 0.5 + half))
    half = T2 * 0.1 / math.sqrt(3)
    assert rows[1].mean() == pytest.approx((0.5, 0.5 - half, 0.5 + half))


def test_the_generalisation_gap_is_demo_less_all_by_task() -> None:
    cells = {"line": [0.9], "line_all": [0.5], "dupe": [1.0], "dupe_all": [0.8]}
    (row,), _ = compared([entry("a", **cells)])
    gap = row.gap()
    assert gap is not None
    assert gap.value == pytest.approx(0.3)
    (row,), _ = compared([entry("a", line=[0.9], dupe_all=[0.1])])
    assert row.gap() is None


@pytest.mark.parametrize(("runs", "unit"), [(2, "rollouts of 2 runs"), (3, "3 runs")])
def test_runs_that_do_not_differ_have_an_interval_over_their_rollouts(runs: int, unit: str) -> None:
    """A zero-width interval would claim that the method is known exactly."""
    cells = {"line": [0.0, 1.0] * 5, "line_all": [0.0, 1.0] * 5}
    (row,), grid = compared([entry("a", **cells) for _ in range(runs)])
    found = row.mean()
    assert isinstance(found, OverRollouts)
    # Wilson's interval of 5 of 10, for the mean of independent cells.
    half = (0.76337 - 0.5) / math.sqrt(2 * runs)
    assert found == pytest.approx((0.5, 0.5 - half, 0.5 + half), abs=1e-4)
    over = "" if runs < 3 else " over rollouts"
    assert grid.rows[0][1:3] == (unit, f"0.50 [{0.5 - half:.2f}, {0.5 + half:.2f}]{over}")
    assert grid.rows[0][3] == "0.50"
    assert grid.rows[0][4].startswith("0.00 [−0.")


def test_two_runs_that_differ_have_an_interval_over_their_rollouts() -> None:
    pair = [entry("a", line=[score] * 10) for score in (0.0, 1.0)]
    rows, grid = compared([*pair, *[entry("b", line=[score]) for score in (0.1, 0.2, 0.3)]])
    assert [row.unit for row in rows] == ["rollouts of 2 runs", "3 runs"]
    assert isinstance(rows[1].difference(rows[0]), OverRollouts)
    assert grid.rows[1][5].endswith("] over rollouts")


def test_few_runs_of_which_some_fail_are_listed() -> None:
    scores = (1.0, 1.0, 0.0)
    multi = [entry("multi", line=[s], dupe=[s], line_all=[0.0]) for s in scores]
    (row,), grid = compared(multi)
    assert grid.rows[0][2].endswith("] (0.67, 0.67, 0.00)")
    assert row.on([DEMO]).apart() == " (1.00, 1.00, 0.00)"
    assert row.apart(gap_weights(row.env_ids)) == " (1.00, 1.00, 0.00)"
    assert grid.note.endswith(RUNS_APART)
    single = [entry("single", line=[s]) for s in scores]
    single += [entry("single", dupe=[s]) for s in (1.0, 0.9, 0.8)]
    (row,), grid = compared(single)
    assert row.apart() == " (MakeLine: 1.00, 1.00, 0.00)"
    even = [entry("a", line=[s]) for s in (1.0, 0.9, 0.8)]
    assert RUNS_APART not in compared(even)[1].note


def test_only_environments_that_all_have_count() -> None:
    rows, grid = compared([entry("a", line=[1.0], dupe=[0.0]), entry("b", line=[0.0])])
    assert grid.note.startswith("Over 1 environment.")
    assert [row.mean().value for row in rows] == [1.0, 0.0]
    assert summary_tables(rows_of([entry("a", line=[1.0]), entry("b", dupe=[0.0])])) == []
    assert summary_tables(rows_of([])) == []


def test_only_environments_that_all_runs_on_a_task_have_count() -> None:
    runs = [entry("a", line=[1.0], line_all=[0.0]), entry("a", line=[1.0]), entry("a", dupe=[0.4])]
    rows, grid = compared(runs)
    assert grid.note.startswith("Over 2 environments.")
    assert rows[0].mean().value == pytest.approx((1.0 + 0.4) / 2)
    assert rows[0].unit == "rollouts of 1 to 2 runs"  # two on one task, one on the other
    assert isinstance(rows[0].mean(), OverRollouts)


def test_rows_and_header_fit() -> None:
    runs = [entry("a", line=[0.5], line_all=[0.5])] * 2 + [entry("b", line=[0.5], line_all=[0.5])]
    _, grid = compared(runs)
    assert grid.header[4:] == ("generalisation gap", "difference from a")
    assert grid.rows[0][:2] == ("a", "rollouts of 2 runs")
    assert grid.rows[0][3] == "0.50"
    assert grid.rows[0][5] == "–"
    assert grid.rows[1][1:4] == ("rollouts of 1 run", "0.50 [0.19, 0.81]", "0.50")
    _, grid = compared([entry("a", line=[0.5])])
    assert grid.header[-1] == "generalisation gap"
    assert grid.rows == [("a", "rollouts of 1 run", "0.50 [0.05, 0.95]", "0.50", "–")]


def test_gaps_have_a_column_for_each_axis_that_there_is() -> None:
    names = ("line", "line_jitter", "line_all")
    means = [("a", (0.9, 0.7, 0.4)), ("a", (0.9, 0.8, 0.5)), ("a", (0.9, 0.9, 0.5))]
    means.append(("b", (1.0, 1.0, 0.0)))
    entries = [
        entry(method, **{name: [mean] for name, mean in zip(names, scores, strict=True)})
        for method, scores in means
    ]
    _, grid = summary_tables(rows_of(entries))
    assert grid.header == ("method", "Jitter", "All")
    half = T2 * math.sqrt(0.01 / 3)  # the runs' gaps are 0.2, 0.1 and 0.0
    assert grid.rows[0][1] == f"0.10 [−{half - 0.1:.2f}, {0.1 + half:.2f}]"
    assert grid.rows[1][2].startswith("1.00 [")
    assert len(summary_tables(rows_of([entry("a", line_all=[1.0])]))) == 1
