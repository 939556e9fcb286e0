"""Score tables."""

import math
from collections.abc import Sequence

import pytest

from magical.evaluation import Entry
from magical.evaluation.statistics import mean
from magical.report.page import _colours
from magical.report.table import (
    BESIDE,
    MARKS,
    ONE_RUN,
    RUNS_APART,
    Cell,
    ScoreTable,
    rows_of,
    summary_tables,
)
from magical.report.table import task_table as table_of_rows
from tests.report.conftest import make_entry as entry


def task_table(task: str, entries: Sequence[Entry], published: Sequence[str] = ()) -> ScoreTable:
    return table_of_rows(task, rows_of(entries), published)


def test_one_run_has_an_interval_over_rollouts() -> None:
    table = task_table("MakeLine", [entry("mine", {"MakeLine-Demo": [0.0, 1.0] * 50})])
    (row,) = table.rows
    low, high = map(float, row.cells["Demo"].detail.strip("[]").split(","))
    assert row.cells["Demo"].mean == 0.5
    assert 0.38 <= low <= 0.42
    assert 0.58 <= high <= 0.62
    assert row.note == "mean, 95% interval over rollouts"
    assert table.variants[:2] == ("Demo", "Jitter")
    assert table.note == "Scored by the appendix's rule." + ONE_RUN
    same = task_table("MoveToRegion", [entry("mine", {"MoveToRegion-Demo": [1.0]})], ["BC (ST)"])
    rule = "On this task, the published code's rule and horizon are the same as the appendix's."
    assert same.note == rule + BESIDE + ONE_RUN


def test_runs_of_a_method_share_a_row() -> None:
    runs = [
        entry("mine", {"MakeLine-Demo": [0.0, 1.0]}),
        entry("mine", {"MakeLine-Demo": [1.0, 1.0]}),
    ]
    table = task_table("MakeLine", runs)
    (row,) = table.rows
    assert row.cells["Demo"] == Cell(0.75, "± 0.25")
    assert row.note == "mean ± std over 2 runs"
    assert table.note == "Scored by the appendix's rule."


def test_rows_are_marked_with_test_evaluations_and_track() -> None:
    scores = {"MakeLine-Demo": [1.0], "MakeLine-TestAll": [0.5]}
    prior = {"learned_from": ["demonstrations", "benchmark prior"], "test_evaluations": 20}
    runs = [
        entry("a", scores, record=prior),
        entry("a", scores, record={"learned_from": ["demonstrations"], "test_evaluations": 0}),
        entry("b", scores, record={"learned_from": ["demonstrations"]}),
        entry("c", scores, record={"learned_from": ["interaction"]}),
        entry("d", scores, record={"learned_from": ["demonstrations"]}, privileged=True),
        entry("e", scores),
    ]
    table = task_table("MakeLine", runs)
    expected = ["a† [B]", "b [P]", "c", "d", "e"]
    assert [row.label.partition(" (")[0] for row in table.rows] == expected
    assert table.note.endswith(MARKS)
    for found in summary_tables(rows_of(runs)):
        assert [row[0].partition(" (")[0] for row in found.rows] == expected


def test_with_published_rows_all_are_scored_by_the_published_rule() -> None:
    mine = entry("mine", {"MakeLine-Demo": [1.0, 1.0]})
    table = task_table("MakeLine", [mine], ["BC (ST)"])
    assert [row.label for row in table.rows] == ["mine", "BC (ST), published"]
    assert table.rows[0].cells["Demo"].mean == 0.5
    assert table.rows[1].cells["Demo"] == Cell(0.48, "± 0.08")
    assert "published code's rule" in table.note


@pytest.mark.parametrize("horizon", ["published", "240"])
def test_published_rows_are_beside_scores_of_the_published_horizon(horizon: str) -> None:
    mine = entry("mine", {"ClusterShape-Demo": [1.0]}, horizon=horizon)
    table = task_table("ClusterShape", [mine], ["BC (ST)"])
    assert [row.cells["Demo"].mean for row in table.rows] == [0.5, 0.35]
    assert table.rows[0].cells["Demo"].difference is not None
    assert "whose horizon is 240 control steps" in table.note


def test_published_rows_are_never_beside_scores_of_another_horizon() -> None:
    scores = {"ClusterShape-Demo": [1.0]}
    mine = entry("mine", scores, horizon="published")
    table = task_table("ClusterShape", [mine, entry("other", scores)], ["BC (ST)"])
    assert [row.label for row in table.rows] == ["mine", "other"]
    assert "another horizon than the appendix's 320 control steps: mine (240)." in table.note
    assert [row.cells["Demo"].mean for row in table.rows] == [1.0, 1.0]
    assert table.note.startswith("Scored by the appendix's rule.")
    assert "The published rows are left out" in table.note
    assert "240 control steps, not 320; evaluate with --horizon published" in table.note
    short = entry("short", {"MakeLine-Demo": [1.0]}, horizon="7")
    assert "180 control steps: short (7)." in task_table("MakeLine", [short]).as_text().note
    assert "--horizon 180 to compare" in task_table("MakeLine", [short], ["BC (ST)"]).note
    elsewhere = entry("elsewhere", {"MakeLine-Demo": [1.0]})
    assert len(task_table("ClusterShape", [mine, elsewhere], ["BC (ST)"]).rows) == 2


def test_few_runs_of_which_some_fail_are_listed() -> None:
    def table(*means: float) -> ScoreTable:
        return task_table("MakeLine", [entry("a", {"MakeLine-Demo": [m]}) for m in means])

    found = table(1.0, 0.0, 0.75)
    assert found.rows[0].cells["Demo"].text == "0.58 ± 0.42 (1.00, 0.00, 0.75)"
    assert found.note.endswith(RUNS_APART)
    for others in (table(1.0, 0.75, 0.75), table(1.0, 0.0, 1.0, 1.0, 1.0, 1.0)):
        assert "(" not in others.rows[0].cells["Demo"].text
        assert RUNS_APART not in others.note


@pytest.mark.parametrize(("runs", "covered"), [(3, 48), (5, 67)])
def test_how_often_an_interval_covers_the_mean_where_one_run_in_five_fails(
    runs: int, covered: int
) -> None:
    share = 0.0
    for failures in range(runs + 1):
        found = mean([[0.0]] * failures + [[1.0]] * (runs - failures))
        likelihood = math.comb(runs, failures) * 0.2**failures * 0.8 ** (runs - failures)
        share += likelihood * (found.low <= 0.8 <= found.high)
    assert round(100 * share) == covered
    assert f"{covered}%" in RUNS_APART


def test_methods_without_the_task_have_no_row() -> None:
    entries = [entry("a", {"MakeLine-Demo": [1.0]}), entry("b", {"FindDupe-Demo": [1.0]})]
    assert rows_of(entries).tasks == ("MakeLine", "FindDupe")
    assert [row.label for row in task_table("FindDupe", entries).rows] == ["b"]
    other = entry("b", {"FindDupe-TestAll": [0.5], "MakeLine-Demo": [0.5]})  # another task's score
    (_, row) = task_table(
        "MakeLine", [entries[0], entry("b", {"MakeLine-Demo": [1.0]}), other]
    ).rows
    assert row.cells["Demo"].mean == 0.75
    (row,) = task_table("FindDupe", [entries[1], other]).rows
    assert row.cells["Demo"].detail.endswith("(1 of 2 runs)")


def test_texts_have_a_dash_where_nothing_was_evaluated() -> None:
    table = task_table("MoveToRegion", [entry("mine", {"MoveToRegion-TestAll": [1.0, 1.0]})])
    assert table.as_text().rows == [("mine", "–", "–", "–", "–", "–", "1.00 [0.34, 1.00]")]


@pytest.mark.parametrize(("mean", "ink"), [(0.0, "#222"), (0.5, "#222"), (1.0, "#fff")])
def test_colours_grow_darker_with_the_score(mean: float, ink: str) -> None:
    found = [_colours(Cell(value, "")) for value in (mean, min(mean + 0.1, 1.0))]
    assert found[0].endswith(f"color:{ink}")
    sums = [sum(map(int, text.split("(")[1].split(")")[0].split(","))) for text in found]
    assert sums[1] <= sums[0]


def test_nudged_runs_have_a_row_of_their_own() -> None:
    scores = {"MakeLine-Demo": [1.0]}
    entries = [entry("mine", scores), entry("mine", scores), entry("mine", scores, nudge=1e-9)]
    table = task_table("MakeLine", entries)
    assert [row.label for row in table.rows] == ["mine", "mine, nudge 1e-09"]
    assert table.rows[0].note == "mean ± std over 2 runs"
