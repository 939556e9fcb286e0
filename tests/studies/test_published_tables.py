"""What the study of the published tables computes, worked out by hand."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

from magical import __version__
from magical.evaluation import environments, published_score, published_tasks
from magical.evaluation.statistics import Interval, Spread
from magical.report.found import search_results
from studies.published_tables.agreement import MARGIN, Agreement, find_agreements
from studies.published_tables.cells import ComparedCell, count, distance_text, make_cells
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
from studies.published_tables.generalisation import find_drops
from studies.published_tables.rows import (
    CODE,
    MethodRuns,
    make_rows,
    published_row,
    reproduced_row,
)
from studies.published_tables.scale import published_contrast
from tests.report.conftest import WriteEntry

CORNER = tuple(environments(["MoveToCorner"], ["Demo", "Jitter"]))


def row(method: str, *means: list[float]) -> MethodRuns:
    return MethodRuns(method, published_row(method), CORNER, np.array(means))


def scores(task: str, rollouts: int = 100, **means: float) -> Mapping[str, list[float]]:
    """Scores by environment; the published code's rule gives half of each."""
    return {
        f"{i.task}-{i.variant}": [means.get(i.variant, means["others"])] * rollouts
        for i in environments([task])
    }


@pytest.mark.parametrize(
    ("method", "published"),
    [
        ("BC (ST)", "BC (ST)"),
        ("BC (ST), scripted experts", "BC (ST)"),
        ("BC (ST, allo.)", "BC (ST, allo.)"),
        ("BC (ST) again", ""),
        ("BC", ""),
    ],
)
def test_a_method_is_held_against_the_row_that_its_name_begins_with(
    method: str, published: str
) -> None:
    assert published_row(method) == published


def test_runs_of_a_method_are_a_row_by_the_published_rule(
    tmp_path: Path, write_entry: WriteEntry
) -> None:
    for seed, (sources, whose, number) in enumerate(
        [
            (["demonstrations"], "10 (human)", 2),
            (["demonstrations"], "25 (expert)", 5),
            (["demonstrations", "simulator"], "10 (human)", 9),
        ]
    ):
        record = {"learned_from": sources, "demonstrations": whose, "test_evaluations": number}
        given = scores("MoveToRegion", others=1.0)
        write_entry(f"{seed}", "BC (ST)", given, seed, version=__version__, record=record)
    corner = {"learned_from": ["demonstrations"]}
    given = scores("MoveToCorner", others=0.0)  # runs that always fail are not copies
    for seed in (3, 4):
        write_entry(f"{seed}", "BC (ST)", given, seed, version=__version__, record=corner)
    (found,), (rejected,) = make_rows(search_results([tmp_path]))
    assert (found.method, found.published, found.means.shape) == ("BC (ST)", "BC (ST)", (4, 12))
    region = [i for i in found.env_ids if i.task == "MoveToRegion"]
    assert found.on(region).tolist() == [[0.5] * 6] * 2
    assert found.runs_in(region[0]).tolist() == [0.5, 0.5]
    assert np.isnan(found.means).sum() == 4 * 6
    assert (found.track, found.statements) == ("P", ("10 (human); 25 (expert)", 5))
    assert rejected.reasons == [
        f"learned from: demonstrations, simulator, but {tmp_path / '0'} of the same method has "
        "demonstrations"
    ]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"version": "9.0.0"}, r"made by version 9\.0\.0 of this package"),
        ({"nudge": 1e-9}, "nudge 1e-09, expected 0: published scores are of the exact scene"),
        ({"horizon": "300"}, "MoveToRegion with another horizon than 40 control steps"),
        ({"rollouts": 3}, "3 rollouts of each environment, expected 100"),
        ({"seed": 1}, "the same run as .*good: each run counts once"),
    ],
)
def test_an_entry_that_cannot_count_is_listed_with_its_reason(
    tmp_path: Path, write_entry: WriteEntry, change: dict[str, Any], reason: str
) -> None:
    given = scores("MoveToRegion", others=1.0)
    write_entry("good", "BC (ST)", given, seed=1, version=__version__)
    fields = {"version": __version__, "seed": 2, **change}
    given = scores("MoveToRegion", fields.pop("rollouts", 100), others=0.0)
    write_entry("other", "BC (ST)", given, **fields)
    (found,), (rejected,) = make_rows(search_results([tmp_path]))
    assert found.means.tolist() == [[0.5] * 6]
    assert Path(rejected.folder).name == "other"
    assert re.search(reason, *rejected.reasons)


def test_what_methods_lose_between_demo_and_test_all(
    tmp_path: Path, write_entry: WriteEntry
) -> None:
    record = {"learned_from": ["demonstrations", "object parser"], "test_evaluations": 2}
    for number, task in enumerate(published_tasks()):
        for seed, demo in enumerate((1.0, 0.8)):
            given = scores(task, Demo=demo, TestAll=0.1 * number, others=0.0)
            how = {"version": __version__, "horizon": "published", "record": record}
            write_entry(f"{task}-{seed}", "mine", given, seed, **how)
    given = scores(task, others=0.5)
    write_entry("one", "one task", given, 2, version=__version__, horizon="published")
    rows, rejected = make_rows(search_results([tmp_path]))
    bc, gail, drop = find_drops(rows)
    assert rejected == []
    assert (bc.method, bc.track, gail.track) == ("BC (ST), published", "P", "")
    assert [bc.demo.value, bc.test_all.value] == pytest.approx([0.64, 0.19], abs=0.005)
    assert gail.gap.value == pytest.approx(0.53, abs=0.005)
    assert math.isnan(bc.gap.low)
    assert (drop.method, drop.track, drop.statements.test_evaluations) == ("mine", "P", 2)
    assert (drop.demo.value, drop.test_all.value) == pytest.approx((0.45, 0.175))
    assert drop.gap.value == pytest.approx(0.275)
    assert drop.gap.low < 0.275 < drop.gap.high


def cell(means: list[float], mean: float, std: float, variant: str = "Demo") -> ComparedCell:
    return ComparedCell("MoveToRegion", variant, np.array(means), Spread(mean, std))


def test_a_distance_by_hand() -> None:
    # Ours: 0.4, 0.6, 0.8: mean 0.6, squares 0.04 + 0 + 0.04 = 0.08. Published: four times 0.1^2.
    found = cell([0.4, 0.6, 0.8], 0.5, 0.1)
    assert (found.mean, found.std) == pytest.approx((0.6, 0.2))
    assert found.distance == pytest.approx(0.1 / math.sqrt((0.08 + 0.04) / 6))
    assert math.isnan(cell([0.7], 0.5, 0.1).std)
    assert cell([0.7], 0.5, 0.1).distance == pytest.approx(2.0)
    # No distance is finer than the tables are rounded.
    assert cell([0.0, 0.0], 0.0, 0.0).distance == 0.0
    assert cell([0.01, 0.01], 0.0, 0.0).distance == pytest.approx(2.0)
    assert [distance_text(value) for value in (1.26, -1.26, -0.04)] == ["+1.3", "−1.3", "0.0"]


def test_a_row_has_the_cells_of_the_tables() -> None:
    env_ids = tuple(environments(["MoveToRegion", "MoveToCorner"]))
    means = np.full((2, len(env_ids)), np.nan)
    means[0, :6], means[1, 6:] = 0.25, 0.75
    cells = make_cells(MethodRuns("BC (ST), slower", "BC (ST)", env_ids, means))
    assert [c.variant for c in cells[:6]] == [
        *("Demo", "Jitter", "Layout", "Colour", "Dynamics", "All"),
    ]
    found = {c.task: c.means.tolist() for c in cells}
    assert found == {"MoveToRegion": [0.25], "MoveToCorner": [0.75]}
    assert cells[-1].published == published_score("MoveToCorner", "BC (ST)", "All")
    assert make_cells(MethodRuns("mine", "", env_ids, means)) == []


def test_counts_and_those_that_chance_gives() -> None:
    names = ("Demo", "Jitter", "Layout", "Colour", "Dynamics", "All")
    means = (0.5, 0.59, 0.35, 0.71, 0.2, 1.0)
    found = count(cell([m], 0.5, 0.1, name) for name, m in zip(names, means, strict=True))
    assert (found.cells, found.within) == (6, (2, 3))
    assert [c.variant for c in found.below] == ["Dynamics"]
    assert [c.variant for c in found.above] == ["All", "Colour"]
    assert found.expected == pytest.approx([6 * one for one in (0.5873, 0.8506)], abs=0.2)
    rng = np.random.default_rng(0)
    ours, theirs = rng.normal(0.5, 0.1, (5000, 3)), rng.normal(0.5, 0.1, (5000, 5))
    pairs = zip(ours, theirs, strict=True)
    distances = [cell(list(a), b.mean(), b.std(ddof=1)).distance for a, b in pairs]
    for limit in (1, 2):
        share = float(np.mean(np.abs(distances) <= limit))
        assert cell([0.0] * 3, 0.5, 0.1).chance(limit) == pytest.approx(share, abs=0.02)


def test_published_contrasts_by_hand() -> None:
    # MoveToCorner: BC (ST) 0.98 and 0.86, no aug. 0.96 and 0.77; standard deviations 0.04 and 0.07,
    # 0.04 and 0.09, which add up within a method. Two parts with four degrees of freedom each.
    weights = {"BC (ST)": 1.0, "BC (ST, no aug.)": -1.0}
    cells = [("MoveToCorner", "Demo"), ("MoveToCorner", "TestJitter")]
    value, low, high = published_contrast(weights, cells)
    assert value == pytest.approx((0.98 - 0.96 + 0.86 - 0.77) / 2)
    a, b = 0.055**2 / 4, 0.065**2 / 4
    half = scipy.stats.t.ppf(0.975, (a + b) ** 2 / ((a**2 + b**2) / 4)) * math.sqrt(a + b)
    assert (low, high) == pytest.approx((value - half, value + half))
    # The runs of a multi-task row are the same for all tasks: standard deviations 0.04 and 0.11,
    # independent; 0.04 and 0.22, of the same runs.
    cells = [("MoveToCorner", "Demo"), ("MoveToRegion", "Demo")]
    single, multi = (published_contrast({f"BC ({kind})": 1.0}, cells) for kind in ("ST", "MT"))
    t = scipy.stats.t.ppf(0.975, 4)
    assert (multi.low, multi.high) == pytest.approx((multi.value - t * 0.13 / 2, 1.0))
    a, b = 0.02**2 / 4, 0.055**2 / 4
    half = scipy.stats.t.ppf(0.975, (a + b) ** 2 / ((a**2 + b**2) / 4)) * math.sqrt(a + b)
    assert single.low == pytest.approx(single.value - half)
    # GAIL (ST) has 1.00 and 0.00 on MoveToRegion Demo, that is a mean and a spread up to 0.005 off.
    found = published_contrast({"GAIL (ST)": 1.0}, [("MoveToRegion", "Demo")])
    assert found == pytest.approx((1.0, 1.0 - t * 0.005 / 2, 1.0))


def test_a_claim_by_hand() -> None:
    rows = [row("BC (ST)", [0.9, 0.8], [0.7, 0.6]), row("BC (ST, no aug.)", [0.5, 0.1], [0.3, 0.1])]
    assert CLAIMS[0].formula == "BC (ST) − BC (ST, no aug.)"
    demo, tests = find(CLAIMS[:1], rows)
    assert (demo.part, tests.part, demo.tasks) == (DEMO, TESTS, ("MoveToCorner",))
    assert demo.ours is not None
    # The runs' standard deviations are 0.1414 both; t with 2 degrees of freedom is 4.303.
    half = 4.3027 * math.sqrt(0.02)
    assert (demo.ours.value, demo.ours.low) == pytest.approx((0.4, 0.4 - half), abs=1e-4)
    assert tests.ours is not None
    assert tests.ours.value == pytest.approx(0.7 - 0.1)
    assert demo.same == published_contrast(CLAIMS[0].weights, [("MoveToCorner", "Demo")])
    assert demo.published is not None
    assert demo.published.value == pytest.approx(0.09, abs=0.01)
    jitter, layout = find(CLAIMS[:1], rows, ("Jitter", "Layout"))
    assert jitter.ours == tests.ours
    assert (layout.tasks, layout.ours) == ((), None)
    code = [row(f"{each.method}, {CODE}", *each.means.tolist()) for each in rows]
    claim = Claim("", {each.method: sign for each, sign in zip(code, (1.0, -1.0), strict=True)})
    assert find([claim], code)[0].same == demo.same  # the published settings, the published values
    few = find(CLAIMS[:1], [replace(rows[0], means=rows[0].means[:1]), rows[1]])
    assert few[0].verdict == "open: too few runs"
    not_run = find(CLAIMS, rows[:1])
    assert {(each.verdict, each.ours, each.same) for each in not_run} == {("not run", None, None)}
    assert all(each.published for each in not_run)
    assert not any(each.published for each in find(VARIATIONS, [], [DEMO]))


def test_three_methods_are_weighed() -> None:
    for claim in CLAIMS:
        assert all(map(reproduced_row, claim.weights))
        assert sum(claim.weights.values()) == 0
    assert CLAIMS[4].formula == ("BC (ST) + BC (ST, no aug.) − 2 x BC (ST, no trans./rot. aug.)")
    rows = [
        row("BC (ST)", [0.91, 0.0], [0.89, 0.0]),
        row("BC (ST, no aug.)", [0.1, 0.0], [0.1, 0.0]),
        row("BC (ST, no trans./rot. aug.)", [0.2, 0.0], [0.2, 0.0]),
    ]
    demo, _ = find(CLAIMS[4:5], rows)
    assert demo.ours is not None
    assert demo.ours.value == pytest.approx(0.6)
    assert demo.verdict == "holds; published: open"


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [(0.1, 0.2, "holds"), (0.0, 0.2, "open"), (-0.2, -0.1, "the opposite holds")],
)
def test_verdicts_of_claims(low: float, high: float, text: str) -> None:
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
    places = [[(p.method, p.rank, p.published_rank) for p in part] for part in (demo, tests)]
    assert places[0] == [("BC (ST)", 1, 1), ("BC (ST, no aug.)", 2, 2)]
    assert places[1] == [("BC (ST, no aug.)", 1, 2), ("BC (ST)", 2, 1)]
    assert order([], DEMO) == ([], [])


def agreements(change: float, spread: float, method: str = "BC (ST)") -> list[Agreement]:
    means = np.array([published_score(i.task, "BC (ST)", i.variant) for i in CORNER])[:, 0] + change
    table = [(means + sign * spread).clip(0, 1).tolist() for sign in (-1, 0, 1, 0)]
    return find_agreements([row(method, *table)])


@pytest.mark.parametrize(
    ("change", "spread", "verdict"),
    [
        (0.0, 0.001, f"equivalent within {MARGIN}"),
        (0.0, 0.2, "open"),
        (-0.05, 0.001, "differs; by how much is open"),
        (-0.3, 0.001, f"differs by more than {MARGIN}"),
    ],
)
def test_verdicts_of_agreement(change: float, spread: float, verdict: str) -> None:
    demo, _ = agreements(change, spread)
    assert demo.verdict == verdict


def test_agreement_by_hand_of_rows_that_are_the_published_ones() -> None:
    demo, tests = agreements(-0.1, 0.05)
    assert (demo.part, tests.part, tests.tasks) == ("Demo", "test variants", ("MoveToCorner",))
    # Four runs, standard deviation 0.0408; t with 3 degrees of freedom at 90% is 2.3534.
    low = 0.88 - 2.3534 * 0.0408 / 2
    assert (demo.ours.value, demo.ours.low) == pytest.approx((0.88, low), abs=1e-4)
    assert demo.difference.value == pytest.approx(-0.1)
    found = find_agreements([row("BC (ST)", [0.98, 0.86])])
    assert {each.verdict for each in found} == {"open: too few runs"}
    assert agreements(0.0, 0.1, "BC (ST), scripted experts") == []
    assert agreements(0.0, 0.001, f"BC (ST), {CODE}")[0].published == demo.published
