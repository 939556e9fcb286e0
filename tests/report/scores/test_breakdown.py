"""Gaps along each axis, and every pair of methods."""

import math

import pytest

from magical.envs import EnvId
from magical.evaluation import Entry, RolloutScore
from magical.report.scores.grids import THRESHOLDS, gap_grid, improvement_table, profiles
from magical.report.scores.methods import compared_methods

VARIANTS = ("Demo", "TestJitter", "TestAll")


def entry(method: str, *means: float) -> Entry:
    """One rollout on Demo, Jitter and All."""
    rows = [
        RolloutScore(EnvId("MakeLine", variant), 0, 0, mean, 0.0)
        for variant, mean in zip(VARIANTS, means, strict=False)
    ]
    return Entry(method=method, scores=rows)


def test_gaps_have_a_column_for_each_axis_that_there_is() -> None:
    entries = [entry("a", 0.9, 0.7, 0.4), entry("a", 0.9, 0.8, 0.5), entry("b", 1.0, 1.0, 0.0)]
    grid = gap_grid(compared_methods(entries))
    assert grid is not None
    assert grid.header == ("method", "Jitter", "All")
    # The runs' gaps are 0.2 and 0.1, and 0.5 and 0.4: half of t(1) = 12.706 times their std's root.
    half = 12.706 * math.sqrt(0.005 / 2)
    assert grid.rows[0][1] == f"0.15 [{0.15 - half:.2f}, {0.15 + half:.2f}]"
    assert grid.rows[1][2].startswith("1.00 [")


def test_without_demo_there_are_no_gaps() -> None:
    rows = [RolloutScore(EnvId("MakeLine", "TestAll"), 0, 0, 1.0, 0.0)]
    assert gap_grid(compared_methods([Entry(method="a", scores=rows)])) is None


def test_every_method_is_compared_with_every_other() -> None:
    entries = [entry("a", 0.9), entry("a", 0.7), entry("b", 0.8), entry("b", 0.6), entry("c", 0.9)]
    table = improvement_table(compared_methods(entries))
    assert table is not None
    assert table.variants == ("a", "b", "c")
    cells = {row.label: {name: cell.mean for name, cell in row.cells.items()} for row in table.rows}
    # Of 4 pairs a wins (0.9, 0.8), (0.9, 0.6), (0.7, 0.6); against c it ties once and loses once.
    assert cells["a"] == pytest.approx({"b": 0.75, "c": 0.25})
    assert cells["b"] == pytest.approx({"a": 0.25, "c": 0.0})
    assert cells["c"] == pytest.approx({"a": 0.75, "b": 1.0})
    assert improvement_table(compared_methods(entries[:2])) is None


def test_profiles_fall_from_left_to_right() -> None:
    methods = compared_methods([entry("a", 0.9), entry("a", 0.3), entry("b", 0.0)])
    found = profiles(methods)
    shares = [interval.value for interval in found["a"]]
    assert shares[0] == 1.0
    assert shares[list(THRESHOLDS).index(0.5)] == 0.5
    assert shares == sorted(shares, reverse=True)
    assert {interval.value for interval in found["b"]} == {0.0}
