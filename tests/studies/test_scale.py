"""Our runs and the published numbers on one scale, worked out by hand."""

import math

import pytest
import scipy.stats

from magical.evaluation.statistics import Spread
from studies.published_tables.scale import pooled_std, published_contrast


def test_the_pooled_standard_deviation_by_hand() -> None:
    # Ours 0.2 and 0.4: squares 0.01 + 0.01. Published: 4 x 0.05^2 = 0.01. Over 2 + 5 - 2 = 5.
    assert pooled_std([0.2, 0.4], Spread(0.9, 0.05)) == pytest.approx(math.sqrt(0.03 / 5))
    assert pooled_std([0.3], Spread(0.9, 0.05)) == pytest.approx(0.05)
    assert pooled_std([0.3, 0.3], Spread(0.9, 0.0)) == 0.005


def test_a_published_contrast_by_hand() -> None:
    # MoveToCorner: BC (ST) 0.98 and 0.86, no aug. 0.96 and 0.77; standard deviations 0.04 and 0.07,
    # 0.04 and 0.09, which add up within a method. Two parts with four degrees of freedom each.
    weights = {"BC (ST)": 1.0, "BC (ST, no aug.)": -1.0}
    cells = [("MoveToCorner", "Demo"), ("MoveToCorner", "TestJitter")]
    value, low, high = published_contrast(weights, cells)
    assert value == pytest.approx((0.98 - 0.96 + 0.86 - 0.77) / 2)
    a, b = 0.055**2 / 4, 0.065**2 / 4
    freedom = (a + b) ** 2 / ((a**2 + b**2) / 4)
    half = scipy.stats.t.ppf(0.975, freedom) * math.sqrt(a + b)
    assert (low, high) == pytest.approx((value - half, value + half))


def test_the_runs_of_a_multi_task_row_are_the_same_for_all_tasks() -> None:
    cells = [("MoveToCorner", "Demo"), ("MoveToRegion", "Demo")]
    single, multi = (published_contrast({f"BC ({kind})": 1.0}, cells) for kind in ("ST", "MT"))
    # Standard deviations 0.04 and 0.11, independent; 0.04 and 0.22, of the same runs.
    t = scipy.stats.t.ppf(0.975, 4)
    assert multi.low == pytest.approx(multi.value - t * 0.13 / 2)
    parts = [0.02**2 / 4, 0.055**2 / 4]
    freedom = sum(parts) ** 2 / (sum(part**2 for part in parts) / 4)
    half = scipy.stats.t.ppf(0.975, freedom) * math.sqrt(sum(parts))
    assert single.low == pytest.approx(single.value - half)
    assert multi.high == 1.0


def test_a_published_spread_is_at_least_its_rounding() -> None:
    # GAIL (ST) has 1.00 and 0.00 on MoveToRegion Demo, that is a mean and a spread up to 0.005 off.
    value, low, high = published_contrast({"GAIL (ST)": 1.0}, [("MoveToRegion", "Demo")])
    half = scipy.stats.t.ppf(0.975, 4) * 0.005 / 2
    assert (value, low, high) == pytest.approx((1.0, 1.0 - half, 1.0))
