"""Score tables, our scores beside the published ones, methods over all environments."""

import math
from collections.abc import Sequence
from typing import Any

import pytest

from magical.evaluation import Entry
from magical.evaluation.statistics import OverRollouts, gap_weights
from magical.report.table import (
    BESIDE,
    MARKS,
    ONE_RUN,
    RUNS_APART,
    Cell,
    Method,
    Table,
    compared_methods,
    differences,
    matching_methods,
    rows_of,
    score_tables,
    summary_tables,
)
from tests.report.conftest import make_entry

BC = "BC (ST)"
T2, T4 = 4.302653, 2.776445  # 97.5% quantiles of Student's t
NAMES = {
    "line": "MakeLine-Demo",
    "line_jitter": "MakeLine-TestJitter",
    "line_all": "MakeLine-TestAll",
    "dupe": "FindDupe-Demo",
    "dupe_all": "FindDupe-TestAll",
}


def entry(method: str, **scores: list[float]) -> Entry:
    return make_entry(method, {NAMES[name]: values for name, values in scores.items()})


def task_table(task: str, entries: Sequence[Entry], published: Sequence[str] = ()) -> Table:
    """The last of a task's tables, which has the published rows if there are any."""
    tables = score_tables(rows_of(entries), published)
    return [table for table in tables if table.header[0] == task][-1]


def labels(table: Table) -> list[Any]:
    return [row[0] for row in table.rows]


def demo(table: Table) -> list[Any]:
    return [row[1] for row in table.rows]


def test_one_run_has_an_interval_over_rollouts() -> None:
    table = task_table("MakeLine", [entry("mine", line=[0.0, 1.0] * 50)])
    (cell,) = demo(table)
    low, high = map(float, cell.detail.strip("[]").split(","))
    assert cell.mean == 0.5
    assert (low, high) == pytest.approx((0.4, 0.6), abs=0.02)
    assert table.row_notes == ["mean, 95% interval over rollouts"]
    assert table.header[:3] == ["MakeLine", "Demo", "Jitter"]
    assert table.note == "Scored by the appendix's rule." + ONE_RUN
    same = task_table("MoveToRegion", [make_entry("mine", {"MoveToRegion-Demo": [1.0]})], [BC])
    rule = "On this task, the published code's rule and horizon are the same as the appendix's."
    assert same.note == rule + BESIDE + ONE_RUN


def test_runs_evaluated_alike_share_a_row() -> None:
    runs = [entry("mine", line=[0.0, 1.0]), entry("mine", line=[1.0, 1.0])]
    nudged = make_entry("mine", {"MakeLine-Demo": [1.0, 1.0]}, nudge=1e-9)
    table = task_table("MakeLine", [*runs, nudged])
    assert labels(table) == ["mine", "mine, nudge 1e-09"]
    assert demo(table)[0] == Cell(0.75, "± 0.25")
    assert table.row_notes[0] == "mean ± std over 2 runs"


def test_rows_are_marked_with_test_evaluations_and_track() -> None:
    scores = {"MakeLine-Demo": [1.0], "MakeLine-TestAll": [0.5]}
    prior = {"learned_from": ["demonstrations", "benchmark prior"], "test_evaluations": 20}
    learned = {"learned_from": ["demonstrations"]}
    runs = [
        make_entry("a", scores, record=prior),
        make_entry("a", scores, record={**learned, "test_evaluations": 0}),
        make_entry("b", scores, record=learned),
        make_entry("c", scores, record={"learned_from": ["interaction"]}),
        make_entry("d", scores, record=learned, privileged=True),
        make_entry("e", scores),
    ]
    table = task_table("MakeLine", runs)
    for found in (table, *summary_tables(rows_of(runs))):
        marked = [label.partition(" (")[0] for label in labels(found)]
        assert marked == ["a† [B]", "b [P]", "c", "d", "e"]
    assert table.note.endswith(MARKS)


def test_few_runs_of_which_some_fail_are_listed() -> None:
    def table(*means: float) -> Table:
        return task_table("MakeLine", [entry("a", line=[m]) for m in means])

    found = table(1.0, 0.0, 0.75)
    assert found.texts[0][1] == "0.58 ± 0.42 (1.00, 0.00, 0.75)"
    assert found.note.endswith(RUNS_APART)
    for others in (table(1.0, 0.75, 0.75), table(1.0, 0.0, 1.0, 1.0, 1.0, 1.0)):
        assert "(" not in others.texts[0][1]
        assert RUNS_APART not in others.note


def test_methods_without_the_task_have_no_row_and_cells_without_scores_a_dash() -> None:
    entries = [entry("a", line=[1.0]), entry("b", dupe=[1.0])]
    assert rows_of(entries).tasks == ("MakeLine", "FindDupe")
    assert labels(task_table("FindDupe", entries)) == ["b"]
    other = entry("b", dupe_all=[0.5], line=[0.5])
    (_, cell) = demo(task_table("MakeLine", [entries[0], entry("b", line=[1.0]), other]))
    assert cell.mean == 0.75
    (cell,) = demo(task_table("FindDupe", [entries[1], other]))
    assert cell.detail.endswith("(1 of 2 runs)")
    table = task_table("MoveToRegion", [make_entry("mine", {"MoveToRegion-TestAll": [1.0, 1.0]})])
    assert table.texts == [["mine", "–", "–", "–", "–", "–", "1.00 [0.34, 1.00]"]]


def test_with_published_rows_all_are_scored_by_the_published_rule() -> None:
    mine = entry("mine", line=[1.0, 1.0])
    table = task_table("MakeLine", [mine], [BC])
    assert labels(table) == ["mine", "BC (ST), published"]
    ours, theirs = demo(table)
    assert (ours.mean, theirs) == (0.5, Cell(0.48, "± 0.08"))
    assert ours.difference.value == pytest.approx(0.02)
    assert str(ours).endswith("] (+0.02)")  # one run: no interval
    assert "published code's rule" in table.note


def test_published_rows_are_beside_scores_of_the_published_horizon_alone() -> None:
    scores = {"ClusterShape-Demo": [1.0]}
    mine = make_entry("mine", scores, horizon="published")
    table = task_table("ClusterShape", [mine], [BC])
    assert [cell.mean for cell in demo(table)] == [0.5, 0.35]
    assert "whose horizon is 240 control steps" in table.note
    table = task_table("ClusterShape", [mine, make_entry("other", scores)], [BC])
    assert labels(table) == ["mine", "other"]
    assert "another horizon than the appendix's 320 control steps: mine (240)." in table.note
    assert [cell.mean for cell in demo(table)] == [1.0, 1.0]
    assert table.note.startswith("Scored by the appendix's rule.")
    assert "240 control steps, not 320; evaluate with --horizon published" in table.note
    short = make_entry("short", {"MakeLine-Demo": [1.0]}, horizon="7")
    assert "180 control steps: short (7)." in task_table("MakeLine", [short]).note
    assert "--horizon 180 to compare" in task_table("MakeLine", [short], [BC]).note


def test_a_method_is_compared_with_the_published_one_of_its_name() -> None:
    ours, others = entry(BC, dupe=[1.0]), entry("mine", dupe=[1.0])
    assert matching_methods([ours, others]) == (BC,)
    for runs, published, expected in (
        ([ours, others], [BC], {BC: BC}),
        ([ours, others], [BC, "AL (ST)"], {BC: BC}),
        ([others], [BC], {"mine": BC}),
        ([others], [BC, "AL (ST)"], {}),
        ([ours], [], {}),
    ):
        found = differences("FindDupe", rows_of(runs), published)
        assert {label: method for label, (method, _) in found.items()} == expected


def test_runs_that_see_the_state_are_marked_and_not_compared_with_rows_of_pixels() -> None:
    run = make_entry("mine", {"FindDupe-Demo": [1.0]}, observation="state")
    table = task_table("FindDupe", [run, entry("other", dupe=[1.0])], [BC])
    assert labels(table) == ["mine (sees the state)", "other", "BC (ST), published"]
    assert [cell.difference is None for cell in demo(table)] == [True, False, True]


def test_nudged_demo_scores_are_not_compared() -> None:
    scores = {"FindDupe-Demo": [1.0], "FindDupe-TestJitter": [1.0]}
    table = task_table("FindDupe", [make_entry("mine", scores, nudge=1e-9)], [BC])
    assert [cell.difference is None for cell in table.rows[0][1:3]] == [True, False]
    assert "except on Demo" in table.row_notes[0]


def test_tables_by_both_rules_where_they_differ() -> None:
    entries = [entry(BC, dupe=[1.0]), make_entry(BC, {"FixColour-Demo": [1.0]})]
    tables = score_tables(rows_of(entries), [BC])
    assert [(table.header[0], table.published, demo(table)[0].mean) for table in tables] == [
        ("FindDupe", False, 1.0),
        ("FindDupe", True, 0.5),
        ("FixColour", True, 0.5),
    ]


def compared(entries: list[Entry]) -> tuple[list[Method], Table]:
    rows = rows_of(entries)
    return compared_methods(rows), summary_tables(rows)[0]


def test_one_run_each_is_compared_over_rollouts() -> None:
    first = entry("first", line=[0.0, 0.0, 0.5, 1.0], dupe=[0.0] * 4)
    second = entry("second", line=[1.0] * 4, dupe=[0.0] * 4)
    rows, table = compared([first, second])
    assert table.note.startswith("Over 2 environments.")
    assert "do not include the spread between training runs" in table.note
    assert table.header[4:] == ["generalisation gap", "difference from first"]
    assert [row[1] for row in table.rows] == ["rollouts of 1 run"] * 2
    assert rows[0].mean().low < 1.5 / 8 < rows[0].mean().high
    assert rows[1].difference(rows[0]).value == pytest.approx(0.5 - 1.5 / 8)
    # The interquartile mean, no gap, no comparison with itself.
    assert table.texts[0][3:] == ["0.19", "–", "–"]
    assert [cell.split()[0] for cell in table.texts[1][4:]] == ["–", "0.31"]
    _, alone = compared([entry("a", line=[0.5])])
    assert alone.rows == [["a", "rollouts of 1 run", "0.50 [0.05, 0.95]", "0.50", "–"]]


def test_several_runs_are_compared_over_runs_and_one_run_over_its_rollouts() -> None:
    runs = [entry("a", line=[*pair]) for pair in ((0.2, 0.4), (0.4, 0.4), (0.5, 0.5))]
    others = [entry("b", line=[score]) for score in (0.4, 0.5, 0.6)]
    a, b, c = compared([*runs, *others, entry("c", line=[0.0, 1.0])])[0]
    assert [row.unit for row in (a, b, c)] == ["3 runs", "3 runs", "rollouts of 1 run"]
    half = T2 * 0.1 / math.sqrt(3)
    assert a.mean() == pytest.approx((0.4, 0.4 - half, 0.4 + half))
    half = T4 * math.sqrt(2 * 0.01 / 3)
    assert b.difference(a) == pytest.approx((0.1, 0.1 - half, 0.1 + half))
    below = math.hypot(c.mean().value - c.mean().low, a.mean().high - 0.4)
    assert c.difference(a).low == pytest.approx(0.1 - below)


@pytest.mark.parametrize(("runs", "unit"), [(2, "rollouts of 2 runs"), (3, "3 runs")])
def test_runs_that_do_not_differ_have_an_interval_over_their_rollouts(runs: int, unit: str) -> None:
    """A zero-width interval would claim that the method is known exactly."""
    cells = {"line": [0.0, 1.0] * 5, "line_all": [0.0, 1.0] * 5}
    (row,), table = compared([entry("a", **cells) for _ in range(runs)])
    found = row.mean()
    assert isinstance(found, OverRollouts)
    # Wilson's interval of 5 of 10, for the mean of independent cells.
    half = (0.76337 - 0.5) / math.sqrt(2 * runs)
    assert found == pytest.approx((0.5, 0.5 - half, 0.5 + half), abs=1e-4)
    over = "" if runs < 3 else " over rollouts"
    assert table.rows[0][1:3] == [unit, f"0.50 [{0.5 - half:.2f}, {0.5 + half:.2f}]{over}"]
    assert table.texts[0][4].startswith("0.00 [−0.")


def test_means_of_few_runs_are_listed_by_the_tasks_they_are_of() -> None:
    scores = (1.0, 1.0, 0.0)
    (row,), table = compared([entry("multi", line=[s], dupe=[s], line_all=[0.0]) for s in scores])
    assert table.texts[0][2].endswith("] (0.67, 0.67, 0.00)")
    assert row.apart(gap_weights(row.env_ids)) == " (1.00, 1.00, 0.00)"
    assert table.note.endswith(RUNS_APART)
    single = [entry("single", line=[s]) for s in scores]
    single += [entry("single", dupe=[s]) for s in (1.0, 0.9, 0.8)]
    (row,), _ = compared(single)
    assert row.apart() == " (MakeLine: 1.00, 1.00, 0.00)"


def test_only_environments_count_that_all_have_and_all_runs_on_a_task() -> None:
    rows, table = compared([entry("a", line=[1.0], dupe=[0.0]), entry("b", line=[0.0])])
    assert table.note.startswith("Over 1 environment. Left out because not all runs and methods")
    assert [row.mean().value for row in rows] == [1.0, 0.0]
    assert summary_tables(rows_of([entry("a", line=[1.0]), entry("b", dupe=[0.0])])) == []
    runs = [entry("a", line=[1.0], line_all=[0.0]), entry("a", line=[1.0]), entry("a", dupe=[0.4])]
    (row,), table = compared(runs)
    assert table.note.startswith("Over 2 environments.")
    assert row.mean().value == pytest.approx((1.0 + 0.4) / 2)
    assert row.unit == "rollouts of 1 to 2 runs"  # two on one task, one on the other


def test_gaps_have_a_column_for_each_axis_that_there_is() -> None:
    means = [("a", (0.9, 0.7, 0.4)), ("a", (0.9, 0.8, 0.5)), ("a", (0.9, 0.9, 0.5))]
    means.append(("b", (1.0, 1.0, 0.0)))
    entries = [entry(m, line=[d], line_jitter=[j], line_all=[a]) for m, (d, j, a) in means]
    _, table = summary_tables(rows_of(entries))
    assert table.header == ["method", "Jitter", "All"]
    half = T2 * math.sqrt(0.01 / 3)  # the runs' gaps are 0.2, 0.1 and 0.0
    assert table.texts[0][1] == f"0.10 [−{half - 0.1:.2f}, {0.1 + half:.2f}]"
    assert table.texts[1][2].startswith("1.00 [")
    assert len(summary_tables(rows_of([entry("a", line_all=[1.0])]))) == 1
