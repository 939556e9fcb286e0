"""The paper's claims, published and ours."""

import math
from dataclasses import replace

import numpy as np
import pytest

from magical.evaluation import environments
from magical.evaluation.statistics import Interval
from studies.published_tables.claims import (
    CLAIMS,
    DEMO,
    TESTS,
    VARIATIONS,
    Claim,
    Finding,
    find,
    order,
    verdict,
)
from studies.published_tables.rows import CODE, MethodRuns, published_row, reproduced_row
from studies.published_tables.scale import published_contrast

CORNER = tuple(environments(["MoveToCorner"], ["Demo", "Jitter"]))


def row(method: str, *means: list[float]) -> MethodRuns:
    return MethodRuns(method, published_row(method), CORNER, np.array(means))


def test_the_published_claims_are_about_published_rows() -> None:
    for claim in CLAIMS:
        assert all(map(reproduced_row, claim.weights))
        assert sum(claim.weights.values()) == 0
    for variation in VARIATIONS:
        assert all(map(published_row, variation.weights))


def test_formulas() -> None:
    assert CLAIMS[0].formula == "BC (ST) − BC (ST, no aug.)"
    assert CLAIMS[4].formula == ("BC (ST) + BC (ST, no aug.) − 2 x BC (ST, no trans./rot. aug.)")


def test_a_claim_by_hand() -> None:
    rows = [row("BC (ST)", [0.9, 0.8], [0.7, 0.6]), row("BC (ST, no aug.)", [0.5, 0.1], [0.3, 0.1])]
    demo, tests = find(CLAIMS[:1], rows)
    assert (demo.part, tests.part, demo.tasks) == (DEMO, TESTS, ("MoveToCorner",))
    assert demo.ours is not None
    assert demo.ours.value == pytest.approx(0.8 - 0.4)
    # The runs' standard deviations are 0.1414 both; t with 2 degrees of freedom is 4.303.
    assert demo.ours.low == pytest.approx(0.4 - 4.3027 * math.sqrt(0.02), abs=1e-4)
    assert tests.ours is not None
    assert tests.ours.value == pytest.approx(0.7 - 0.1)
    assert demo.same == published_contrast(CLAIMS[0].weights, [("MoveToCorner", "Demo")])
    assert demo.same is not None
    assert demo.same.value == pytest.approx(0.98 - 0.96)
    assert demo.published is not None
    assert demo.published.value == pytest.approx(0.09, abs=0.01)
    jitter, layout = find(CLAIMS[:1], rows, ("Jitter", "Layout"))
    assert jitter.ours == tests.ours
    assert jitter.same == published_contrast(CLAIMS[0].weights, [("MoveToCorner", "Jitter")])
    assert (layout.tasks, layout.ours) == ((), None)
    assert find(CLAIMS[:1], [replace(rows[0], means=rows[0].means[:1]), rows[1]])[0].verdict == (
        "open: too few runs"
    )


def test_three_methods_are_weighed() -> None:
    rows = [
        row("BC (ST)", [0.91, 0.0], [0.89, 0.0]),
        row("BC (ST, no aug.)", [0.1, 0.0], [0.1, 0.0]),
        row("BC (ST, no trans./rot. aug.)", [0.2, 0.0], [0.2, 0.0]),
    ]
    demo, _ = find(CLAIMS[4:5], rows)
    assert demo.ours is not None
    assert demo.ours.value == pytest.approx(0.6)
    assert demo.ours.low < 0.6 < demo.ours.high
    assert demo.verdict == "holds; published: open"


def test_what_has_not_been_run_says_so() -> None:
    found = find(CLAIMS, [row("BC (ST)", [0.9, 0.8])])
    assert {finding.verdict for finding in found} == {"not run"}
    assert all(finding.ours is finding.same is None for finding in found)
    assert all(finding.published is not None for finding in found)


def test_claims_of_methods_with_the_published_settings_have_the_published_values() -> None:
    quick, code = (row(f"GAIL (ST){name}", [0.9, 0.8]) for name in ("", f", {CODE}"))
    claims = [Claim("", {method: 1.0, "BC (ST)": -1.0}) for method in (quick.method, code.method)]
    both = find(claims, [quick, code, row("BC (ST)", [0.5, 0.4])], [DEMO])
    assert both[0].same is not None
    assert (both[0].published, both[0].same) == (both[1].published, both[1].same)


def test_variations_have_no_published_value() -> None:
    assert not any(found.published for found in find(VARIATIONS, [], [DEMO]))


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (0.1, 0.2, "holds"),
        (-0.1, 0.2, "open"),
        (-0.2, -0.1, "the opposite holds"),
        (0.0, 0.1, "open"),
    ],
)
def test_verdicts(low: float, high: float, text: str) -> None:
    interval = Interval((low + high) / 2, low, high)
    assert verdict(interval) == text
    claim = Claim("a is better", {"a": 1.0, "b": -1.0})
    agreeing = Finding(claim, DEMO, ("FindDupe",), interval, interval, interval)
    assert agreeing.verdict == f"{text}, as published"


def test_orders() -> None:
    rows = [
        row("BC (ST, no aug.)", [0.5, 0.9], [0.4, 0.9]),
        row("BC (ST)", [0.9, 0.1], [0.8, 0.1]),
        row("BC (ST), scripted experts", [1.0, 1.0], [1.0, 1.0]),
    ]
    (tasks, demo), (_, tests) = order(rows, DEMO), order(rows, TESTS)
    assert tasks == ["MoveToCorner"]
    assert [(p.method, p.rank, p.published_rank) for p in demo] == [
        ("BC (ST)", 1, 1),
        ("BC (ST, no aug.)", 2, 2),
    ]
    assert [(p.method, p.published_rank) for p in tests] == [
        ("BC (ST, no aug.)", 2),
        ("BC (ST)", 1),
    ]
    assert demo[0].published.value == 0.98
    assert order([], DEMO) == ([], [])
