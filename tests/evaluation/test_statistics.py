"""Statistics: worked out by hand, and against scipy."""

import math

import numpy as np
import pytest
import scipy.stats

from magical.envs import EnvId
from magical.errors import UnknownNameError
from magical.evaluation import RolloutScore
from magical.evaluation import statistics as stats
from magical.evaluation.statistics import Interval, rollout_mean

NAN = math.nan
T2, T3, T4 = 4.302653, 3.182446, 2.776445  # 97.5% quantiles of Student's t
IDS = [EnvId("MakeLine", variant) for variant in ("Demo", "TestJitter", "TestAll")]
OTHERS = [EnvId("FindDupe", variant) for variant in ("Demo", "TestAll")]


def around(value: float, half_width: float) -> Interval:
    return Interval(value, value - half_width, value + half_width)


def approximately(interval: Interval) -> object:
    return pytest.approx(tuple(interval), abs=2e-6, nan_ok=True)


# The paper's figure.


def test_over_runs_is_the_mean_and_std_of_run_means() -> None:
    runs = [[0.0, 1.0], [1.0, 1.0], [0.0, 0.0]]  # run means 0.5, 1.0, 0.0
    assert stats.over_runs(runs) == pytest.approx((0.5, np.sqrt(1 / 6)))
    # The spread within a run is ignored.
    assert stats.over_runs([[0.0, 1.0], [1.0, 0.0]]) == (0.5, 0.0)


# From rollouts to run means.


def rollouts(env_id: EnvId, *scores: float) -> list[RolloutScore]:
    return [RolloutScore(env_id, i, i, score, score / 2) for i, score in enumerate(scores)]


def test_run_means_have_a_row_for_each_run() -> None:
    runs = [rollouts(IDS[0], 0.0, 1.0) + rollouts(IDS[1], 0.2), rollouts(IDS[0], 1.0)]
    np.testing.assert_allclose(stats.run_means(runs, IDS[:2]), [[0.5, 0.2], [1.0, NAN]])
    published = stats.run_means(runs, IDS[:2], "published_code_score")
    np.testing.assert_allclose(published, [[0.25, 0.1], [0.5, NAN]])
    # Rows of an environment need not follow each other.
    apart = rollouts(IDS[0], 0.0) + rollouts(IDS[1], 0.2) + rollouts(IDS[0], 1.0)
    np.testing.assert_allclose(stats.run_means([apart], IDS[:2]), [[0.5, 0.2]])


# Means over runs.


ONE_TASK = [[0.3, NAN], [0.4, NAN], [0.5, NAN]]  # the mean's squared standard error is 0.01 / 3
HALF = math.sqrt(0.01 / 3 / 4)  # of the mean over two tasks of which the other does not vary


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([[0.3], [0.4], [0.5]], around(0.4, T2 * 0.1 / math.sqrt(3))),
        ([[0.3, 0.3], [0.4, 0.4], [0.5, 0.5]], around(0.4, T2 * 0.1 / math.sqrt(3))),
        # Each run's mean is 0.5: runs do not vary, though each environment's scores do.
        ([[0.2, 0.8], [0.8, 0.2]], Interval(0.5, NAN, NAN)),
        # Tasks are strata.
        ([*ONE_TASK, *[[NAN, 0.6]] * 3], around(0.5, T2 * HALF)),
        ([*ONE_TASK, [NAN, 0.5], [NAN, 0.6], [NAN, 0.7]], around(0.5, T4 * HALF * math.sqrt(2))),
        # The interval ends where scores do.
        ([[0.8], [1.0]], Interval(0.9, 0.0, 1.0)),
    ],
)
def test_mean_has_student_s_interval_over_runs(
    scores: list[list[float]], expected: Interval
) -> None:
    assert stats.mean(scores) == approximately(expected)


def test_environments_count_alike_and_one_run_has_no_interval() -> None:
    assert stats.mean([*ONE_TASK, [NAN, 0.7], [NAN, 0.9]]).value == pytest.approx((0.4 + 0.8) / 2)
    for statistic in (stats.mean, stats.interquartile_mean):
        value, low, high = statistic([[0.4, 0.4]])
        assert value == pytest.approx(0.4)
        assert math.isnan(low)
        assert math.isnan(high)


def test_mean_agrees_with_scipy() -> None:
    scores = np.random.default_rng(0).random((6, 1))
    result = scipy.stats.ttest_1samp(scores[:, 0], 0.0).confidence_interval(0.9)
    assert stats.mean(scores, confidence=0.9)[1:] == pytest.approx(tuple(result))


# The interquartile mean.


def test_interquartile_mean_leaves_out_a_quarter_at_either_end() -> None:
    # Two of 0.4 and two of 0.6 are left; the winsorised scores, four of each, have the standard
    # deviation 0.1 sqrt(8 / 7), and the error is that over half the square root of 8.
    found = stats.interquartile_mean([[s] for s in (0.0, 0.1, 0.4, 0.4, 0.6, 0.6, 0.9, 1.0)])
    assert found == approximately(around(0.5, T3 * 0.2 / math.sqrt(7)))


def test_interquartile_mean_rounds_the_quarter_down_and_pools_environments() -> None:
    # Six scores over two environments: one left out at either end.
    found = stats.interquartile_mean([[0.9, 0.1], [0.2, 0.3], [1.0, 0.0]])
    assert found.value == pytest.approx((0.1 + 0.2 + 0.3 + 0.9) / 4)
    block = [[0.9, NAN], [NAN, 0.1], [0.2, NAN], [NAN, 0.3], [1.0, NAN], [NAN, 0.0]]
    assert stats.interquartile_mean(block).value == pytest.approx(found.value)
    scores = np.random.default_rng(0).random((5, 7))
    trimmed = scipy.stats.trim_mean(scores, proportiontocut=0.25, axis=None)
    assert stats.interquartile_mean(scores).value == pytest.approx(trimmed)


# The generalisation gap.


@pytest.mark.parametrize(
    ("means", "env_ids", "expected"),
    [
        # 0.4 on MakeLine and 0.2 on FindDupe in both runs.
        (
            [[0.9, 0.1, 0.5, 1.0, 0.8], [0.8, 0.1, 0.4, 1.0, 0.8]],
            IDS + OTHERS,
            Interval(0.3, NAN, NAN),
        ),
        # Gaps 0.3, 0.4, 0.5.
        ([[0.6, 0.3], [0.6, 0.2], [0.6, 0.1]], IDS[::2], around(0.4, T2 * 0.1 / math.sqrt(3))),
        # FindDupe has no TestAll.
        (
            [[0.9, 0.5, NAN]] * 2 + [[NAN, NAN, 1.0]],
            [*IDS[::2], OTHERS[0]],
            Interval(0.4, NAN, NAN),
        ),
    ],
)
def test_generalisation_gap_is_demo_less_all_by_task_then_over_tasks(
    means: list[list[float]], env_ids: list[EnvId], expected: Interval
) -> None:
    assert stats.generalisation_gap(means, env_ids) == approximately(expected)
    # Along an axis it is over the tasks that have it.
    found = stats.generalisation_gap([[0.9, 0.6, 0.0, 1.0, 0.8]], IDS + OTHERS, "Jitter")
    assert found.value == pytest.approx(0.3)


@pytest.mark.parametrize("variant", ["TestShape", "Demo"])
def test_a_gap_without_two_variants_is_refused(variant: str) -> None:
    with pytest.raises(ValueError, match=f"Demo and another variant of the same task.*{variant}"):
        stats.generalisation_gap([[0.9, 0.5, 0.5]], IDS, variant)
    with pytest.raises(ValueError, match="found 3 columns and 5 environments"):
        stats.generalisation_gap([[0.9, 0.5, 0.5]], IDS + OTHERS)


# Two methods.


def test_difference_has_welch_s_interval() -> None:
    first, second = np.array([[0.5], [0.6], [0.7]]), np.array([[0.1], [0.2], [0.3]])
    found = stats.difference(first, second)
    assert found == approximately(around(0.4, T4 * math.sqrt(2 * 0.01 / 3)))
    first, second = np.random.default_rng(0).random((6, 1)), np.full((4, 1), 0.5)
    second[0] = 0.3
    test = scipy.stats.ttest_ind(first[:, 0], second[:, 0], equal_var=False)
    interval = tuple(test.confidence_interval())
    assert stats.difference(first, second)[1:] == pytest.approx(interval)


# Over rollouts.


def test_over_rollouts_is_the_weighted_sum_of_environments() -> None:
    run = rollouts(IDS[0], *[1.0] * 8, 0.0, 0.0) + rollouts(IDS[2], *[1.0] * 10)
    env_ids = [IDS[0], IDS[2]]
    low, high = math.hypot(0.8 - 0.490162, 1 - 0.722467), 0.943318 - 0.8
    mean = stats.over_rollouts([run], env_ids, [0.5, 0.5])
    assert mean == approximately(Interval(0.9, 0.9 - low / 2, 0.9 + high / 2))
    gap = stats.over_rollouts([run], env_ids, stats.gap_weights(env_ids))
    assert gap == approximately(
        Interval(-0.2, -0.2 - (0.8 - 0.490162), -0.2 + math.hypot(high, 1 - 0.722467))
    )
    runs = [rollouts(IDS[0], 1.0), rollouts(IDS[0], 0.0, 0.0, 0.0)]  # weighed equally
    assert stats.over_rollouts(runs, IDS[:1], [1.0]).value == 0.5
    with pytest.raises(ValueError, match="expected rollouts in magical/MakeLine-TestJitter-v0"):
        stats.over_rollouts(runs, IDS, [1.0] * 3)


# Wrong input.


@pytest.mark.parametrize(
    ("scores", "message"),
    [
        ([0.0, 1.0], r"scores\[:, None\]"),
        ([[]], "found shape"),
        ([[0.5, NAN], [0.5, NAN]], "in each row and each column"),
        ([[0.5, 0.5], [NAN, NAN]], "in each row and each column"),
        ([[50.0]], "from 0 to 1, found 50"),
    ],
)
def test_wrong_scores_are_refused_with_what_was_expected(
    scores: list[list[float]], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        stats.mean(scores)


def test_wrong_words_and_confidences_are_named() -> None:
    runs = [rollouts(IDS[0], 0.5), rollouts(IDS[0], 1.0)]
    for scores in ([[0.5], [0.6]], [[0.5]]):
        with pytest.raises(ValueError, match="confidence: expected more than 0"):
            stats.mean(scores, 95)
    with pytest.raises(ValueError, match="confidence: expected more than 0"):
        rollout_mean([0.5, 0.6], 95)
    with pytest.raises(UnknownNameError, match="one of: score, published_code_score"):
        stats.run_means(runs, IDS, "seed")
    with_preset = [f"{IDS[0][:-3]}-LoRes4E-v0"]
    np.testing.assert_array_equal(stats.run_means(runs, with_preset), [[0.5], [1.0]])


def test_a_contrast_weighs_methods() -> None:
    first, second, third = np.array([[[0.5], [0.7]], [[0.1], [0.3]], [[0.2], [0.4]]])
    value, low, high = stats.contrast([first, second, third], [1.0, 1.0, -2.0])
    assert value == pytest.approx(0.6 + 0.2 - 2 * 0.3)
    # Variances of the means 0.01, 0.01 and, of twice the third, 0.04, each with one degree of
    # freedom: 0.06^2 / (0.0001 + 0.0001 + 0.0016) = 2.
    half = scipy.stats.t.ppf(0.975, 2) * math.sqrt(0.06)
    assert (low, high) == pytest.approx((value - half, value + half))
    assert stats.contrast([first, second], [1.0, -1.0]) == stats.difference(first, second)
    with pytest.raises(ValueError, match=r"in the same environments, found \[1, 2\] columns"):
        stats.contrast([first, np.full((2, 2), 0.5)], [1.0, -1.0])
