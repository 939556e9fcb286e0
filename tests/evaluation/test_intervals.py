"""Intervals: worked out by hand, against published examples, and by simulation."""

import math

import numpy as np
import pytest

from magical.evaluation import statistics as stats
from magical.evaluation.statistics import Floats, Interval, rollout_mean, weighted_sum
from magical.tasks import TASKS


def approximately(interval: Interval) -> object:
    return pytest.approx(tuple(interval), abs=2e-6)


@pytest.mark.parametrize(
    ("successes", "count", "low", "high"),
    [(8, 10, 0.490162, 0.943318), (10, 10, 0.722467, 1.0), (0, 10, 0.0, 0.277533)],
)
def test_rollouts_have_wilson_s_interval(
    successes: int, count: int, low: float, high: float
) -> None:
    found = rollout_mean([1.0] * successes + [0.0] * (count - successes))
    assert found == approximately(Interval(successes / count, low, high))


def test_scores_between_0_and_1_vary_less_than_successes() -> None:
    # A variance of 0.16 is worth 4 x 0.25 / 0.16 = 6.25 successes and failures.
    ratio = 1.959964**2 / 6.25
    half = math.sqrt(ratio * 0.25 / (1 + ratio))
    assert rollout_mean([0.1, 0.9, 0.1, 0.9]) == approximately(
        Interval(0.5, 0.5 - half, 0.5 + half)
    )


def test_nearly_equal_scores_have_an_interval() -> None:
    found = rollout_mean([0.5] * 10)
    assert found == approximately(rollout_mean([0.0, 1.0] * 5))
    assert rollout_mean([1 / 3] * 10).low < 1 / 3 < rollout_mean([1 / 3] * 10).high
    # A mean near the ceiling can lie above its estimate: here that of infinitely many is 0.995.
    assert rollout_mean([1.0] * 98 + [0.5] * 2).high > 0.995


def test_square_and_add_gives_newcombe_s_example() -> None:
    # Newcombe (1998), Statistics in Medicine 17, 873-890, Table II (a), method 10.
    first, second = (rollout_mean([1.0] * a + [0.0] * (n - a)) for a, n in ((56, 70), (48, 80)))
    found = weighted_sum([first, second], [1.0, -1.0])
    assert found == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)


@pytest.mark.parametrize("scores", [[[0.5]], [], [1.5]])
def test_wrong_rollouts_are_refused(scores: list[float]) -> None:
    with pytest.raises(ValueError, match="scores: expected"):
        rollout_mean(scores)


# Coverage. Scores are a mean, plus an effect of the run that its environments share, plus a
# residual; studies/published_tables/intervals.py does the same with more samples and compares
# other intervals.

RUN_EFFECT, RESIDUAL = 0.08, 0.03  # standard deviations
VARIANTS = [len(task.variants) for task in TASKS.values()]
DESIGNS = {
    "one task": [max(VARIANTS)],
    "one multi-task policy": [sum(VARIANTS)],
    "a run for each task": VARIANTS,
}


def simulate(widths: list[int], runs: int, mean: float, rng: np.random.Generator) -> Floats:
    """Scores (runs, environments) of `runs` runs for each stratum; environments do not differ."""
    table = np.full((runs * len(widths), sum(widths)), np.nan)
    for number, width in enumerate(widths):
        effects = RUN_EFFECT * rng.normal(size=(runs, 1))
        residuals = RESIDUAL * rng.normal(size=(runs, width))
        # The ends of the range are five standard deviations away: coverage does not notice.
        scores = np.clip(mean + effects + residuals, 0.0, 1.0)
        column = sum(widths[:number])
        table[number * runs : (number + 1) * runs, column : column + width] = scores
    return table


@pytest.mark.parametrize(("runs", "least"), [(5, 0.88), (20, 0.93)])
@pytest.mark.parametrize("widths", DESIGNS.values(), ids=DESIGNS)
def test_intervals_over_runs_cover(widths: list[int], runs: int, least: float) -> None:
    rng = np.random.default_rng(0)
    covered = []
    for _ in range(1500):
        scores = simulate(widths, runs, 0.5, rng)
        intervals = (stats.mean(scores), stats.interquartile_mean(scores))
        covered.append([low <= 0.5 <= high for _, low, high in intervals])
    assert np.mean(covered, axis=0).min() >= least


@pytest.mark.parametrize("gain", [0.0, 0.2])
@pytest.mark.parametrize("widths", DESIGNS.values(), ids=DESIGNS)
def test_comparisons_of_two_methods_cover(widths: list[int], gain: float) -> None:
    rng = np.random.default_rng(0)
    covered = []
    for _ in range(200):
        first, second = simulate(widths, 5, 0.4 + gain, rng), simulate(widths, 5, 0.4, rng)
        _, low, high = stats.difference(first, second)
        covered.append(low <= gain <= high)
    assert np.mean(covered) >= 0.88
