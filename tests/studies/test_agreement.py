"""Whether means over environments agree with the published ones."""

import numpy as np
import pytest

from magical.evaluation import environments, published_score
from studies.published_tables.agreement import MARGIN, Agreement, find_agreements
from studies.published_tables.rows import CODE, MethodRuns, published_row

CORNER = tuple(environments(["MoveToCorner"], ["Demo", "Jitter", "Dynamics"]))
PUBLISHED = [
    spread.mean for i in CORNER if (spread := published_score(i.task, "BC (ST)", i.variant))
]


def agreements(change: float, spread: float, method: str = "BC (ST)") -> list[Agreement]:
    means = np.array(PUBLISHED) + change
    table = np.array([means + sign * spread for sign in (-1, 0, 1, 0)])
    return find_agreements([MethodRuns(method, published_row(method), CORNER, table.clip(0, 1))])


def test_a_row_by_hand() -> None:
    demo, tests = agreements(-0.1, 0.05)
    assert (demo.part, tests.part, tests.tasks) == ("Demo", "test variants", ("MoveToCorner",))
    assert demo.ours.value == pytest.approx(0.88)
    # Four runs, standard deviation 0.0408; t with 3 degrees of freedom at 90% is 2.3534.
    assert demo.ours.low == pytest.approx(0.88 - 2.3534 * 0.0408 / 2, abs=1e-4)
    assert demo.difference.value == pytest.approx(-0.1)


@pytest.mark.parametrize(
    ("change", "spread", "verdict"),
    [
        (0.0, 0.001, f"equivalent within {MARGIN}"),
        (0.0, 0.2, "open"),
        (-0.05, 0.001, "differs; by how much is open"),
        (-0.3, 0.001, f"differs by more than {MARGIN}"),
    ],
)
def test_verdicts(change: float, spread: float, verdict: str) -> None:
    demo, _ = agreements(change, spread)
    assert demo.verdict == verdict


def test_one_run_is_too_few() -> None:
    row = MethodRuns("BC (ST)", "BC (ST)", CORNER, np.array([PUBLISHED]))
    assert {found.verdict for found in find_agreements([row])} == {"open: too few runs"}


def test_rows_that_are_not_the_published_ones_are_left_out() -> None:
    assert agreements(0.0, 0.1, "BC (ST), scripted experts") == []


def test_a_row_with_the_published_codes_settings_is_held_against_the_published_one() -> None:
    demo, _ = agreements(0.0, 0.001, f"BC (ST), {CODE}")
    assert demo.verdict == f"equivalent within {MARGIN}"
    assert demo.published == agreements(0.0, 0.001)[0].published
