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
from magical.evaluation.statistics import Spread
from magical.tasks import TASKS


def test_the_table_is_the_one_that_was_checked_against_the_appendix(root: Path) -> None:
    file = root / "src" / "magical" / "evaluation" / "data" / "published-scores.csv"
    sha256 = "7090cbc8fdb278c03140581e52c0b31b2e3f4a1ab24ecd9d5d6539a2cc2a2301"
    assert hashlib.sha256(file.read_bytes()).hexdigest() == sha256
    assert len(published_table()) == 660
    assert published_score("MoveToRegion", "GAIL (ST, allo.)", "TestColour") == (0.95, 0.02)
    assert published_score("ClusterShape", "GAIL (ST)", "Jitter") == (0.44, 0.08)
    assert published_score("MoveToRegion", "BC (ST)", "Shape") is None  # a dash
    for task in published_tasks():
        for method in published_methods():
            assert None not in [published_score(task, method, v) for v in TASKS[task].variants]


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


def test_the_difference_from_a_published_mean_has_welch_s_interval() -> None:
    ours, theirs = [0.5, 0.7, 0.9], Spread(0.6, 0.1)
    value, low, high = difference_from_published(ours, theirs)
    # Our mean is 0.7 with the variance 0.04 / 3; theirs has 0.01 / 4, whatever the divisor of 0.1.
    ours_of, theirs_of = 0.04 / 3, 0.01 / 4
    freedom = (ours_of + theirs_of) ** 2 / (ours_of**2 / 2 + theirs_of**2 / 4)
    half = float(scipy.stats.t.ppf(0.975, freedom)) * math.sqrt(ours_of + theirs_of)
    assert (value, low, high) == pytest.approx((0.1, 0.1 - half, 0.1 + half))
    _, low, high = difference_from_published([0.996] * 5, Spread(1.0, 0.0))  # rounded to 0.00
    assert low < 0.0 < high
    found = difference_from_published([0.2, 0.3], Spread(0.5, 0.1))  # too few runs
    assert found == pytest.approx((-0.25, math.nan, math.nan), nan_ok=True)
