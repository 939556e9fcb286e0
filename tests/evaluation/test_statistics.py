"""Statistics: worked out by hand, against published examples and scipy."""

import math

import numpy as np
import pytest
import scipy.stats

from magical.envs import EnvId
from magical.evaluation import RolloutScore
from magical.evaluation import statistics as stats
from magical.evaluation.statistics import Interval, rollout_mean, weighted_sum

NAN = math.nan
T2, T3, T4 = 4.302653, 3.182446, 2.776445  # 97.5% quantiles of Student's t
IDS = [EnvId("MakeLine", variant) for variant in ("Demo", "TestJitter", "TestAll")]
OTHERS = [EnvId("FindDupe", variant) for variant in ("Demo", "TestAll")]


def around(value: float, half_width: float) -> Interval:
    return Interval(value, value - half_width, value + half_width)


def approximately(interval: Interval) -> object:
    return pytest.approx(tuple(interval), abs=2e-6, nan_ok=True)


def rollouts(env_id: EnvId, *scores: float) -> list[RolloutScore]:
    return [RolloutScore(env_id, i, i, score, score / 2) for i, score in enumerate(scores)]


# Over rollouts.


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
    assert rollout_mean([0.1, 0.9, 0.1, 0.9]) == approximately(around(0.5, half))
    # Equal scores, which rounding may make differ, are worth as many as there are.
    assert rollout_mean([0.5] * 10) == approximately(rollout_mean([0.0, 1.0] * 5))
    assert rollout_mean([1 / 3] * 10).low < 1 / 3 < rollout_mean([1 / 3] * 10).high
    # A mean near the ceiling can lie above its estimate: here that of infinitely many is 0.995.
    assert rollout_mean([1.0] * 98 + [0.5] * 2).high > 0.995


def test_square_and_add_gives_newcombe_s_example() -> None:
    # Newcombe (1998), Statistics in Medicine 17, 873-890, Table II (a), method 10.
    first, second = (rollout_mean([1.0] * a + [0.0] * (n - a)) for a, n in ((56, 70), (48, 80)))
    found = weighted_sum([first, second], [1.0, -1.0])
    assert found == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)


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


# Over runs.


def test_over_runs_is_the_mean_and_std_of_run_means() -> None:
    runs = [[0.0, 1.0], [1.0, 1.0], [0.0, 0.0]]  # run means 0.5, 1.0, 0.0
    assert stats.over_runs(runs) == pytest.approx((0.5, np.sqrt(1 / 6)))
    # The spread within a run is ignored.
    assert stats.over_runs([[0.0, 1.0], [1.0, 0.0]]) == (0.5, 0.0)


def test_run_means_have_a_row_for_each_run() -> None:
    runs = [rollouts(IDS[0], 0.0, 1.0) + rollouts(IDS[1], 0.2), rollouts(IDS[0], 1.0)]
    with_preset = f"{IDS[0][:-3]}-LoRes4E-v0"
    found = stats.run_means(runs, [with_preset, IDS[1]])
    np.testing.assert_allclose(found, [[0.5, 0.2], [1.0, NAN]])
    published = stats.run_means(runs, IDS[:2], "published_code_score")
    np.testing.assert_allclose(published, [[0.25, 0.1], [0.5, NAN]])
    # Rows of an environment need not follow each other.
    apart = rollouts(IDS[0], 0.0) + rollouts(IDS[1], 0.2) + rollouts(IDS[0], 1.0)
    np.testing.assert_allclose(stats.run_means([apart], IDS[:2]), [[0.5, 0.2]])


ONE_TASK = [[0.3, NAN], [0.4, NAN], [0.5, NAN]]  # the mean's squared standard error is 0.01 / 3
HALF = math.sqrt(0.01 / 3 / 4)  # of the mean over two tasks of which the other does not vary


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([[0.3], [0.4], [0.5]], around(0.4, T2 * 0.1 / math.sqrt(3))),
        ([[0.3, 0.3], [0.4, 0.4], [0.5, 0.5]], around(0.4, T2 * 0.1 / math.sqrt(3))),
        # Each run's mean is 0.5: runs do not vary, though each environment's scores do.
        ([[0.2, 0.8], [0.8, 0.2]], Interval(0.5, NAN, NAN)),
        # Tasks are strata, and environments count alike.
        ([*ONE_TASK, *[[NAN, 0.6]] * 3], around(0.5, T2 * HALF)),
        ([*ONE_TASK, [NAN, 0.5], [NAN, 0.6], [NAN, 0.7]], around(0.5, T4 * HALF * math.sqrt(2))),
        # The interval ends where scores do.
        ([[0.8], [1.0]], Interval(0.9, 0.0, 1.0)),
        ([[0.4, 0.4]], Interval(0.4, NAN, NAN)),
    ],
)
def test_mean_has_student_s_interval_over_runs(
    scores: list[list[float]], expected: Interval
) -> None:
    assert stats.mean(scores) == approximately(expected)


def test_mean_and_difference_agree_with_scipy() -> None:
    first, second = np.random.default_rng(0).random((6, 1)), np.full((4, 1), 0.5)
    second[0] = 0.3
    result = scipy.stats.ttest_1samp(first[:, 0], 0.0).confidence_interval(0.9)
    assert stats.mean(first, confidence=0.9)[1:] == pytest.approx(tuple(result))
    test = scipy.stats.ttest_ind(first[:, 0], second[:, 0], equal_var=False)
    interval = tuple(test.confidence_interval())
    assert stats.difference(first, second)[1:] == pytest.approx(interval)


def test_a_contrast_weighs_methods() -> None:
    first, second, third = np.array([[[0.5], [0.7]], [[0.1], [0.3]], [[0.2], [0.4]]])
    value, low, high = stats.contrast([first, second, third], [1.0, 1.0, -2.0])
    assert value == pytest.approx(0.6 + 0.2 - 2 * 0.3)
    # Variances of the means 0.01, 0.01 and, of twice the third, 0.04, each with one degree of
    # freedom: 0.06^2 / (0.0001 + 0.0001 + 0.0016) = 2.
    half = scipy.stats.t.ppf(0.975, 2) * math.sqrt(0.06)
    assert (low, high) == pytest.approx((value - half, value + half))
    with pytest.raises(ValueError, match=r"in the same environments, found \[1, 2\] columns"):
        stats.contrast([first, np.full((2, 2), 0.5)], [1.0, -1.0])


def test_interquartile_mean_leaves_out_a_quarter_at_either_end() -> None:
    # Two of 0.4 and two of 0.6 are left; the winsorised scores, four of each, have the standard
    # deviation 0.1 sqrt(8 / 7), and the error is that over half the square root of 8.
    found = stats.interquartile_mean([[s] for s in (0.0, 0.1, 0.4, 0.4, 0.6, 0.6, 0.9, 1.0)])
    assert found == approximately(around(0.5, T3 * 0.2 / math.sqrt(7)))
    # Six scores over two environments, which are pooled: one left out at either end.
    found = stats.interquartile_mean([[s, s] for s in (0.5, 0.6, 0.7)])
    assert found == approximately(around(0.6, T2 * math.sqrt(3 * 0.0025)))
    block = [[0.9, NAN], [NAN, 0.1], [0.2, NAN], [NAN, 0.3], [1.0, NAN], [NAN, 0.0]]
    assert stats.interquartile_mean(block).value == pytest.approx((0.1 + 0.2 + 0.3 + 0.9) / 4)
    scores = np.random.default_rng(0).random((5, 7))
    trimmed = scipy.stats.trim_mean(scores, proportiontocut=0.25, axis=None)
    assert stats.interquartile_mean(scores).value == pytest.approx(trimmed)


@pytest.mark.parametrize(
    ("means", "env_ids", "expected"),
    [
        # 0.4 on MakeLine and 0.2 on FindDupe in both runs.
        ([[0.9, 0.1, 0.5, 1.0, 0.8]] * 2, IDS + OTHERS, Interval(0.3, NAN, NAN)),
        # Gaps 0.3, 0.4, 0.5.
        ([[0.6, s] for s in (0.3, 0.2, 0.1)], IDS[::2], around(0.4, T2 * 0.1 / math.sqrt(3))),
        # FindDupe has no TestAll.
        ([[0.9, 0.5, NAN], [NAN, NAN, 1.0]], [*IDS[::2], OTHERS[0]], Interval(0.4, NAN, NAN)),
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
    with pytest.raises(ValueError, match="scores: expected"):
        rollout_mean([[0.5]])
    with pytest.raises(ValueError, match="confidence: expected more than 0"):
        stats.mean([[0.5], [0.6]], 95)
