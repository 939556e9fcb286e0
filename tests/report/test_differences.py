"""Our scores beside the published ones."""

import math
from typing import Any

import pytest

from magical.evaluation import Entry, published_score
from magical.report.table import (
    counterparts,
    differences,
    matching_methods,
    rows_of,
    score_tables,
    task_table,
)
from magical.tasks import get_task
from tests.report.conftest import make_entry

BC = "BC (ST)"


def entry(env: str, score: float, method: str = BC, **fields: Any) -> Entry:
    return make_entry(method, {env: [score, score]}, **fields)


def test_a_method_is_held_against_the_published_one_of_its_name() -> None:
    ours, others = entry("FindDupe-Demo", 1.0), entry("FindDupe-Demo", 1.0, "mine")
    assert matching_methods([ours, others]) == (BC,)
    assert counterparts(rows_of([ours, others]), [BC]) == {BC: BC}
    assert counterparts(rows_of([ours, others]), [BC, "AL (ST)"]) == {BC: BC}
    assert counterparts(rows_of([others]), [BC]) == {"mine": BC}
    assert counterparts(rows_of([others]), [BC, "AL (ST)"]) == {}
    assert counterparts(rows_of([ours]), []) == {}


def test_differences_are_by_the_published_rule() -> None:
    runs = [entry("FindDupe-Demo", score) for score in (0.8, 0.9, 1.0)]
    found = differences(get_task("FindDupe"), runs, BC)
    published = published_score("FindDupe", BC, "Demo")
    assert published is not None
    assert found["Demo"].value == pytest.approx(0.45 - published.mean)
    assert found["Demo"].low < found["Demo"].value < found["Demo"].high


@pytest.mark.parametrize(
    ("horizon", "compared"), [("appendix", False), ("published", True), ("240", True)]
)
def test_only_runs_with_the_published_horizon_are_compared(horizon: str, compared: bool) -> None:
    run = entry("ClusterShape-Demo", 1.0, horizon=horizon)
    assert bool(differences(get_task("ClusterShape"), [run], BC)) == compared


def test_runs_that_see_the_state_are_marked_and_not_compared_with_rows_of_pixels() -> None:
    run = entry("FindDupe-Demo", 1.0, "mine", observation="state")
    assert not differences(get_task("FindDupe"), [run], BC)
    table = task_table("FindDupe", rows_of([run, entry("FindDupe-Demo", 1.0, "other")]), [BC])
    assert [row.label for row in table.rows] == [
        *("mine (sees the state)", "other", "BC (ST), published"),
    ]
    assert [len(row.cells["Demo"].beside) for row in table.rows] == [0, 1, 0]


def test_nudged_demo_scores_are_not_compared() -> None:
    task = get_task("FindDupe")
    demo, jitter = (entry(f"FindDupe-{v}", 1.0, nudge=1e-9) for v in ("Demo", "TestJitter"))
    assert not differences(task, [demo], BC)
    assert set(differences(task, [jitter], BC)) == {"Jitter"}
    assert "except on Demo" in task_table("FindDupe", rows_of([jitter]), [BC]).rows[0].note


def test_cells_show_the_difference() -> None:
    table = task_table("MoveToRegion", rows_of([entry("MoveToRegion-Demo", 1.0)]), [BC])
    published = published_score("MoveToRegion", BC, "Demo")
    assert published is not None
    expected = f"{0.5 - published.mean:+.2f}".replace("-", "−")
    assert table.rows[0].cells["Demo"].beside == [expected]
    assert table.as_text().rows[0][1].endswith(f"({expected})")
    assert table.rows[1].cells["Demo"].difference is None
    interval = table.rows[0].cells["Demo"].difference
    assert interval is not None
    assert math.isnan(interval.low)


def test_tables_by_both_rules_where_they_differ() -> None:
    entries = [entry("FindDupe-Demo", 1.0), entry("FixColour-Demo", 1.0)]
    tables = score_tables(rows_of(entries), [BC])
    assert [(t.task, t.published) for t in tables] == [
        ("FindDupe", False),
        ("FindDupe", True),
        ("FixColour", True),
    ]
    assert [t.rows[0].cells["Demo"].mean for t in tables] == [1.0, 0.5, 0.5]
