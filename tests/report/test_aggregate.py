"""All environments in one figure a method."""

import pytest

from magical.envs import EnvId
from magical.evaluation import Entry, RolloutScore
from magical.report.aggregate import aggregate_header, aggregate_rows, aggregates

LINE, DUPE = EnvId("MakeLine", "Demo"), EnvId("FindDupe", "Demo")


def entry(method: str, **scores: list[float]) -> Entry:
    names = {"line": LINE, "dupe": DUPE}
    rows = [
        RolloutScore(names[name], i, i, score, 0.0)
        for name, values in scores.items()
        for i, score in enumerate(values)
    ]
    return Entry(method=method, scores=rows)


def test_one_run_each_is_compared_over_rollouts() -> None:
    first = entry("first", line=[0.0, 0.0, 0.5, 1.0], dupe=[0.0] * 4)
    second = entry("second", line=[1.0] * 4, dupe=[0.0] * 4)
    lines, note = aggregates([first, second])
    assert "2 environments" in note
    assert "rollouts" in note
    assert lines[0].mean.value == pytest.approx(1.5 / 8)
    # Sorted: six zeros, 0.5, 1.0; two left out at either end.
    assert lines[0].interquartile_mean.value == 0.0
    assert lines[1].optimality_gap.value == 0.5
    assert lines[0].improvement is None
    # On line it wins three of four and ties once; on dupe it ties always.
    assert lines[1].improvement is not None
    assert lines[1].improvement.value == pytest.approx((3.5 / 4 + 0.5) / 2)


def test_several_runs_each_are_compared_over_run_means() -> None:
    runs = [entry("a", line=[0.0, 1.0]), entry("a", line=[1.0, 1.0])]
    others = [entry("b", line=[1.0, 1.0]), entry("b", line=[1.0, 0.8])]
    lines, note = aggregates([*runs, *others])
    assert "bootstrap over runs" in note
    assert lines[0].mean == (0.75, 0.5, 1.0)
    assert lines[1].improvement is not None
    assert lines[1].improvement.value == pytest.approx((0.5 + 1 + 0 + 1) / 4)


def test_only_environments_that_all_have_count() -> None:
    lines, note = aggregates([entry("a", line=[1.0], dupe=[0.0]), entry("b", line=[0.0])])
    assert note.startswith("Over 1 environment;")
    assert [line.mean.value for line in lines] == [1.0, 0.0]
    assert aggregates([entry("a", line=[1.0]), entry("b", dupe=[0.0])])[0] == []


def test_rows_and_header_fit() -> None:
    lines, _ = aggregates([entry("a", line=[1.0]), entry("b", line=[0.0])])
    header, rows = aggregate_header(lines), aggregate_rows(lines)
    assert header[-1] == "P(better than a)"
    assert rows[1] == (
        "b",
        "0.00 [0.00, 0.00]",
        "0.00 [0.00, 0.00]",
        "1.00 [1.00, 1.00]",
        "0.00 [0.00, 0.00]",
    )
    assert {len(row) for row in rows} == {len(header)}
