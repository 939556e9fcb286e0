"""The published tables."""

import hashlib
import math
from pathlib import Path

import pytest
import scipy.stats

from magical.errors import UnknownNameError
from magical.evaluation import (
    difference_from_published,
    published_methods,
    published_score,
    published_table,
    published_tasks,
)
from magical.evaluation.published import pooled_std, published_contrast
from magical.evaluation.statistics import Spread
from magical.tasks import TASKS


def test_entries_read_off_the_appendix() -> None:
    assert published_score("MoveToCorner", "BC (ST)", "Demo") == (0.98, 0.04)
    assert published_score("MoveToRegion", "GAIL (ST, allo.)", "TestColour") == (0.95, 0.02)
    assert published_score("ClusterShape", "GAIL (ST)", "Jitter") == (0.44, 0.08)
    assert published_score("FixColour", "WGAIL-GP (ST)", "All") == (0.05, 0.02)


def test_a_dash_is_none() -> None:
    assert published_score("MoveToRegion", "BC (ST)", "Shape") is None


def test_every_variant_of_every_task_has_every_method() -> None:
    assert len(published_table()) == 660
    assert set(published_tasks()) <= set(TASKS)
    for task in published_tasks():
        for method in published_methods():
            for variant in TASKS[task].variants:
                assert published_score(task, method, variant) is not None


@pytest.mark.parametrize(
    ("names", "listed"),
    [
        (("MoveIt", "BC (ST)", "Demo"), "MoveToCorner"),
        (("MoveToCorner", "BC", "Demo"), r"BC \(ST\)"),
        (("MoveToCorner", "BC (ST)", "Color"), "Colour"),
    ],
)
def test_unknown_names_list_what_there_is(names: tuple[str, str, str], listed: str) -> None:
    with pytest.raises(UnknownNameError, match=listed):
        published_score(*names)


def test_the_table_is_the_one_that_was_checked_against_the_appendix(root: Path) -> None:
    file = root / "src" / "magical" / "evaluation" / "data" / "published-scores.csv"
    sha256 = "7090cbc8fdb278c03140581e52c0b31b2e3f4a1ab24ecd9d5d6539a2cc2a2301"
    assert hashlib.sha256(file.read_bytes()).hexdigest() == sha256


def test_the_difference_from_a_published_mean_has_welch_s_interval() -> None:
    ours, theirs = [0.5, 0.7, 0.9], Spread(0.6, 0.1)
    value, low, high = difference_from_published(ours, theirs)
    # Our mean is 0.7 with the variance 0.04 / 3; theirs has 0.01 / 4, whatever the divisor of 0.1.
    ours_of, theirs_of = 0.04 / 3, 0.01 / 4
    freedom = (ours_of + theirs_of) ** 2 / (ours_of**2 / 2 + theirs_of**2 / 4)
    half = float(scipy.stats.t.ppf(0.975, freedom)) * math.sqrt(ours_of + theirs_of)
    assert (value, low, high) == pytest.approx((0.1, 0.1 - half, 0.1 + half))


def test_one_run_differs_without_an_interval() -> None:
    value, low, high = difference_from_published([0.25], Spread(0.5, 0.1))
    assert value == -0.25
    assert math.isnan(low)
    assert math.isnan(high)


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
