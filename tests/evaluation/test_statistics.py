"""Statistics against cases worked out by hand, and against rliable where it is installed."""

import numpy as np
import pytest

from magical.evaluation import statistics as stats


def test_over_runs_is_the_mean_and_std_of_run_means() -> None:
    runs = [[0.0, 1.0], [1.0, 1.0], [0.0, 0.0]]  # run means 0.5, 1.0, 0.0
    assert stats.over_runs(runs) == pytest.approx((0.5, np.sqrt(1 / 6)))
    assert stats.over_runs(runs, ddof=1) == pytest.approx((0.5, 0.5))


def test_the_std_over_runs_ignores_the_spread_within_a_run() -> None:
    assert stats.over_runs([[0.0, 1.0], [1.0, 0.0]]) == (0.5, 0.0)


def test_interquartile_mean_leaves_out_a_quarter_at_either_end() -> None:
    column = np.array([1.0, 0.0, 0.2, 0.5, 0.6, 0.7, 0.4, 1.0])[:, None]
    assert stats.interquartile_mean(column) == pytest.approx((0.4 + 0.5 + 0.6 + 0.7) / 4)


def test_interquartile_mean_rounds_the_quarter_down_and_pools_strata() -> None:
    # Six scores over two strata: one left out at either end.
    table = np.array([[0.9, 0.1], [0.2, 0.3], [1.0, 0.0]])
    assert stats.interquartile_mean(table) == pytest.approx((0.1 + 0.2 + 0.3 + 0.9) / 4)


def test_optimality_gap_counts_only_what_is_missing() -> None:
    table = np.array([[0.2, 1.4], [1.0, 0.6]])
    assert stats.optimality_gap(table) == pytest.approx((0.8 + 0.0 + 0.0 + 0.4) / 4)
    assert stats.optimality_gap(table, target=0.5) == pytest.approx(0.3 / 4)


def test_probability_of_improvement_counts_ties_half() -> None:
    first, second = np.array([[1.0], [0.5]]), np.array([[0.5], [0.0], [0.5]])
    # 1.0 beats all three; 0.5 beats one and ties with two.
    assert stats.probability_of_improvement(first, second) == pytest.approx((3 + 1 + 1) / 6)


def test_probability_of_improvement_weighs_strata_equally() -> None:
    first, second = np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])
    assert stats.probability_of_improvement(first, second) == 0.5


@pytest.mark.parametrize("statistic", [stats.mean, stats.interquartile_mean, stats.optimality_gap])
def test_statistics_work_on_stacks_of_tables(statistic: stats.Statistic) -> None:
    tables = np.random.default_rng(0).random((5, 12, 3))
    together = statistic(tables)
    assert together.shape == (5,)
    np.testing.assert_allclose(together, [statistic(table) for table in tables])


def test_bootstrap_of_a_fair_coin_agrees_with_the_normal_approximation() -> None:
    scores = np.repeat([0.0, 1.0], 50)[:, None]
    value, low, high = stats.bootstrap_interval(scores, np.random.default_rng(0), draws=20_000)
    half_width = 1.96 * 0.5 / np.sqrt(100)
    assert value == 0.5
    assert low == pytest.approx(0.5 - half_width, abs=0.011)  # the mean moves in steps of 0.01
    assert high == pytest.approx(0.5 + half_width, abs=0.011)


def test_bootstrap_is_stratified() -> None:
    # Each stratum is constant: drawing within strata leaves the mean as it is, mixing would not.
    table = np.tile([0.0, 1.0], (10, 1))
    assert stats.bootstrap_interval(table, np.random.default_rng(0)) == (0.5, 0.5, 0.5)


def test_strata_are_drawn_independently_of_each_other() -> None:
    # Each row's mean is 0.5: drawing whole rows would leave nothing to vary.
    table = np.tile([[0.0, 1.0], [1.0, 0.0]], (10, 1))
    value, low, high = stats.bootstrap_interval(table, np.random.default_rng(0))
    half_width = 1.96 * 0.5 / np.sqrt(40)
    assert (value, low, high) == pytest.approx((0.5, 0.5 - half_width, 0.5 + half_width), abs=0.03)


def test_bootstrap_covers_the_true_mean_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(200):
        _, low, high = stats.bootstrap_interval(rng.random((40, 2)), rng, draws=300)
        covered += low <= 0.5 <= high
    assert 0.88 <= covered / 200 <= 0.99


def test_bootstrap_does_not_depend_on_how_it_is_cut_up(monkeypatch: pytest.MonkeyPatch) -> None:
    table = np.random.default_rng(1).random((10, 2))
    whole = stats.bootstrap_interval(table, np.random.default_rng(2), draws=500)
    monkeypatch.setattr(stats, "CHUNK", 60)
    assert stats.bootstrap_interval(table, np.random.default_rng(2), draws=500) == whole


def test_bootstrap_difference_draws_both_sides() -> None:
    first, second = np.repeat([0.0, 1.0], 50)[:, None], np.repeat([0.0, 1.0, 1.0, 1.0], 25)[:, None]
    rng = np.random.default_rng(0)
    value, low, high = stats.bootstrap_difference(first, second, rng, draws=20_000)
    half_width = 1.96 * np.sqrt((0.25 + 0.1875) / 100)
    assert value == -0.25
    assert (low, high) == pytest.approx((-0.25 - half_width, -0.25 + half_width), abs=0.012)


def test_bootstrap_difference_takes_the_probability_of_improvement() -> None:
    better, worse = np.full((5, 1), 0.9), np.full((7, 1), 0.1)
    compare = stats.probability_of_improvement
    rng = np.random.default_rng(0)
    assert stats.bootstrap_difference(better, worse, rng, compare, draws=50) == (1.0, 1.0, 1.0)


def test_a_plain_list_of_scores_is_refused_with_what_to_do() -> None:
    with pytest.raises(ValueError, match=r"scores\[:, None\]"):
        stats.bootstrap_interval([0.0, 1.0], np.random.default_rng(0))


def test_generalisation_gaps_are_demo_less_variant() -> None:
    gaps = stats.generalisation_gaps({"Demo": 0.9, "TestJitter": 0.7, "TestAll": 1.0})
    assert gaps == pytest.approx({"Jitter": 0.2, "All": -0.1})


def test_agreement_with_rliable() -> None:
    pytest.importorskip("rliable", reason="rliable is not installed")
    from rliable import library, metrics

    rng = np.random.default_rng(5)
    table, other = np.round(rng.random((10, 4)), 1), np.round(rng.random((7, 4)), 1)
    assert stats.interquartile_mean(table) == pytest.approx(metrics.aggregate_iqm(table))
    assert stats.optimality_gap(table) == pytest.approx(metrics.aggregate_optimality_gap(table))
    assert stats.probability_of_improvement(table, other) == pytest.approx(
        metrics.probability_of_improvement(table, other)
    )
    _, theirs = library.get_interval_estimates(
        {"it": table}, lambda x: np.array([metrics.aggregate_iqm(x)]), reps=20_000
    )
    ours = stats.bootstrap_interval(table, rng, stats.interquartile_mean, draws=20_000)
    assert (ours.low, ours.high) == pytest.approx(tuple(theirs["it"][:, 0]), abs=0.01)
