"""Distances from published means, and their counts."""

import math

import numpy as np
import pytest

from magical.evaluation import environments, published_score
from magical.evaluation.statistics import Spread
from studies.published_tables.cells import ComparedCell, count, distance_text, make_cells
from studies.published_tables.rows import MethodRuns


def cell(means: list[float], mean: float, std: float, variant: str = "Demo") -> ComparedCell:
    return ComparedCell("MoveToRegion", variant, np.array(means), Spread(mean, std))


def test_a_distance_by_hand() -> None:
    # Ours: 0.4, 0.6, 0.8: mean 0.6, squares 0.04 + 0 + 0.04 = 0.08. Published: four times 0.1^2.
    found = cell([0.4, 0.6, 0.8], 0.5, 0.1)
    assert found.mean == pytest.approx(0.6)
    assert found.std == pytest.approx(0.2)
    assert found.distance == pytest.approx(0.1 / math.sqrt((0.08 + 0.04) / 6))


def test_distances_of_one_run_and_of_runs_that_are_alike() -> None:
    assert math.isnan(cell([0.7], 0.5, 0.1).std)
    assert cell([0.7], 0.5, 0.1).distance == pytest.approx(2.0)
    # No distance is finer than the tables are rounded.
    assert cell([0.0, 0.0], 0.0, 0.0).distance == 0.0
    assert cell([0.01, 0.01], 0.0, 0.0).distance == pytest.approx(2.0)


def test_a_row_has_the_cells_of_the_tables() -> None:
    env_ids = tuple(environments(["MoveToRegion", "MoveToCorner"]))
    means = np.full((2, len(env_ids)), np.nan)
    means[0, :6], means[1, 6:] = 0.25, 0.75
    cells = make_cells(MethodRuns("BC (ST), slower", "BC (ST)", env_ids, means))
    assert [c.variant for c in cells] == [
        *("Demo", "Jitter", "Layout", "Colour", "Dynamics", "All"),
        *("Demo", "Jitter", "Colour", "Shape", "Dynamics", "All"),
    ]
    assert {c.task: c.means.tolist() for c in cells} == {
        "MoveToRegion": [0.25],
        "MoveToCorner": [0.75],
    }
    assert cells[-1].published == published_score("MoveToCorner", "BC (ST)", "All")
    assert make_cells(MethodRuns("mine", "", env_ids, means)) == []


def test_counts() -> None:
    names = ("Demo", "Jitter", "Layout", "Colour", "Dynamics", "All")
    means = (0.5, 0.59, 0.35, 0.71, 0.2, 1.0)
    found = count(cell([m], 0.5, 0.1, name) for name, m in zip(names, means, strict=True))
    assert (found.cells, found.within) == (6, (2, 3))
    assert [c.variant for c in found.below] == ["Dynamics"]
    assert [c.variant for c in found.above] == ["All", "Colour"]
    assert found.expected == pytest.approx([6 * one for one in (0.5873, 0.8506)], abs=0.2)


def test_chance_is_that_of_two_samples_of_a_normal_distribution() -> None:
    rng = np.random.default_rng(0)
    ours, theirs = rng.normal(0.5, 0.1, (20_000, 3)), rng.normal(0.5, 0.1, (20_000, 5))
    pairs = zip(ours, theirs, strict=True)
    distances = [cell(list(a), b.mean(), b.std(ddof=1)).distance for a, b in pairs]
    for limit in (1, 2):
        share = float(np.mean(np.abs(distances) <= limit))
        assert cell([0.0] * 3, 0.5, 0.1).chance(limit) == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize(
    ("value", "text"), [(1.26, "+1.3"), (-1.26, "−1.3"), (-0.04, "0.0"), (0.0, "0.0")]
)
def test_a_distance_as_text(value: float, text: str) -> None:
    assert distance_text(value) == text
