"""Coverage and width of confidence intervals, by simulation.

A run's score in an environment is the environment's mean, plus an effect of the run that all its
environments share, plus a residual. Each line gives, for one design, statistic and number of runs,
how often each kind of 95% interval covers the true value, and its mean width. "ours" is what
magical.evaluation.statistics computes, or this script for the probability of improvement;
"separate" resamples each environment's scores on their own, as rliable's stratified bootstrap does;
the others resample whole runs. The second table is for the rollouts of a single run in one
environment.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri, stdtrit

from magical.evaluation import statistics
from magical.evaluation.statistics import Interval, rollout_mean, wilson_interval
from magical.tasks import TASKS

Floats = NDArray[np.float64]
Strata = Sequence[Floats]  # (..., runs, environments) for each group of runs trained alike
Bounds = tuple[float, float]

RUN_EFFECT, RESIDUAL = 0.08, 0.03  # standard deviations
LOWEST, HIGHEST = 0.5, 0.7  # mean scores of the environments
RUNS = (3, 5, 10, 20)
TAILS = np.array([0.025, 0.975])
VARIANTS = [len(task.variants) for task in TASKS.values()]
DESIGNS = {
    f"one task, {max(VARIANTS)} variants": [max(VARIANTS)],
    f"multi-task, {sum(VARIANTS)} environments": [sum(VARIANTS)],
    f"single-task, {len(VARIANTS)} tasks": VARIANTS,
}
ROLLOUTS = 100


@dataclass(frozen=True)
class Statistic:
    """A statistic of the strata of one method, or of two after each other.

    `parts` gives its value and each run's contribution to it, for stacks of samples.
    """

    ours: Callable[..., Interval]  # of one (runs, environments) array, or of two
    parts: Callable[[Strata], tuple[Floats, list[Floats]]]
    truth: Callable[[Floats], float]  # of the first method's environment means
    gains: tuple[float, ...] = (0.0,)  # of each method over the last
    least: float = 0.0  # possible value; the greatest is 1


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--simulations", type=int, default=1000, help="default: 1000")
    parser.add_argument("--resamples", type=int, default=500, help="of a bootstrap; default: 500")
    parser.add_argument("--runs", type=int, nargs="+", default=RUNS)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    kinds = ("ours", "separate", "percentile", "BCa", "studentised")
    print_row("coverage (mean width); design, statistic, runs", kinds)
    for design, widths in DESIGNS.items():
        for name, statistic in STATISTICS.items():
            for runs in args.runs:
                found = [
                    intervals(statistic, samples, rng, args.resamples)
                    for samples in simulate(statistic, widths, runs, rng, args.simulations)
                ]
                truth = statistic.truth(environment_means(sum(widths)))
                print_row(f"{design}, {name}, {runs}", summary(found, truth))
    print_row(f"\n{ROLLOUTS} rollouts of one run", ("ours", "percentile", "t"))
    for name, (truth, sample) in ROLLOUT_SCORES.items():
        found = [
            rollout_intervals(sample(rng), rng, args.resamples) for _ in range(args.simulations)
        ]
        print_row(name, summary(found, truth))


def print_row(label: str, cells: Sequence[str]) -> None:
    print(f"{label:56}", *(f"{cell:>14}" for cell in cells), flush=True)


def summary(found: Sequence[Sequence[Bounds]], truth: float) -> list[str]:
    """Coverage in per cent and mean width of each kind of interval."""
    low, high = np.moveaxis(np.array(found), -1, 0)  # (simulations, kinds) each
    # Bounds of scores that are all alike differ from the truth by rounding.
    coverage = ((low <= truth + 1e-9) & (truth - 1e-9 <= high)).mean(axis=0)
    widths = (high - low).mean(axis=0)
    return [f"{c:.1%} ({w:.3f})" for c, w in zip(coverage, widths, strict=True)]


def environment_means(environments: int) -> Floats:
    """Means (environments,) of the first method; skewed, so that IQM and mean differ."""
    return LOWEST + (HIGHEST - LOWEST) * np.linspace(0.0, 1.0, environments) ** 2


def simulate(
    statistic: Statistic, widths: Sequence[int], runs: int, rng: np.random.Generator, count: int
) -> Iterator[list[Floats]]:
    """Samples of the statistic's methods, each a list of strata (runs, environments)."""
    means = np.split(environment_means(sum(widths)), np.cumsum(widths)[:-1])
    for _ in range(count):
        yield [
            np.clip(
                mean
                - (statistic.gains[0] - gain)
                + RUN_EFFECT * rng.standard_normal((runs, 1))
                + RESIDUAL * rng.standard_normal((runs, len(mean))),
                0.0,
                1.0,
            )
            for gain in statistic.gains
            for mean in means
        ]


def intervals(
    statistic: Statistic, strata: list[Floats], rng: np.random.Generator, resamples: int
) -> list[Bounds]:
    """Every kind of interval for one sample, in the table's order."""
    methods = len(statistic.gains)
    size = len(strata) // methods
    tables = [block_diagonal(strata[size * i : size * (i + 1)]) for i in range(methods)]
    ours = statistic.ours(*tables)
    value, contributions = statistic.parts(strata)
    error = standard_error(contributions)
    separate, _ = statistic.parts([resample_columns(table, rng, resamples) for table in strata])
    values, resampled = statistic.parts([resample_runs(table, rng, resamples) for table in strata])
    return [
        (ours.low, ours.high),
        percentiles(separate),
        percentiles(values),
        percentiles(values, bca_levels(value, values, contributions)),
        studentised(statistic, value, error, values, standard_error(resampled)),
    ]


def block_diagonal(strata: Strata) -> Floats:
    """One (runs, environments) array, NaN where a stratum's runs were not evaluated."""
    table = np.full((sum(map(len, strata)), sum(s.shape[1] for s in strata)), np.nan)
    row = column = 0
    for stratum in strata:
        rows, columns = stratum.shape
        table[row : row + rows, column : column + columns] = stratum
        row, column = row + rows, column + columns
    return table


def resample_runs(table: Floats, rng: np.random.Generator, resamples: int) -> Floats:
    rows = rng.integers(len(table), size=(resamples, len(table)))
    chosen: Floats = table[rows]
    return chosen  # (resamples, runs, environments)


def resample_columns(table: Floats, rng: np.random.Generator, resamples: int) -> Floats:
    rows = rng.integers(len(table), size=(resamples, *table.shape))
    chosen: Floats = table[rows, np.arange(table.shape[1])]
    return chosen


def percentiles(values: Floats, levels: Floats = TAILS) -> Bounds:
    low, high = np.quantile(values, levels)
    return float(low), float(high)


def bca_levels(value: Floats, values: Floats, contributions: Sequence[Floats]) -> Floats:
    """Bias-corrected and accelerated levels (Efron, 1987)."""
    below = ((values < value).mean() + (values <= value).mean()) / 2
    bias = ndtri(np.clip(below, 1 / len(values), 1 - 1 / len(values)))
    centred = np.concatenate([part - part.mean() for part in contributions])
    square = (centred**2).sum() ** 1.5
    acceleration = (centred**3).sum() / (6 * square) if square else 0.0
    shifted = bias + ndtri(TAILS)
    levels: Floats = ndtr(bias + shifted / (1 - acceleration * shifted))
    return levels


def studentised(
    statistic: Statistic, value: Floats, error: Floats, values: Floats, errors: Floats
) -> Bounds:
    """The bootstrap t interval; a resample without spread counts as infinitely far away."""
    away = values - value
    ratios = np.divide(away, errors, out=np.sign(away) * 1e6, where=errors > 1e-12)
    low, high = np.quantile(ratios, TAILS)
    return max(float(value - high * error), statistic.least), min(float(value - low * error), 1.0)


def standard_error(contributions: Sequence[Floats]) -> Floats:
    """Of a sum of contributions (..., runs) from independent strata."""
    variances = [part.shape[-1] * part.var(axis=-1, ddof=1) for part in contributions]
    error: Floats = np.sqrt(np.sum(variances, axis=0))
    return error


def mean_parts(strata: Strata) -> tuple[Floats, list[Floats]]:
    """The mean over environments; of stacks (..., runs, environments)."""
    size = sum(s.shape[-1] for s in strata)
    parts = [s.sum(axis=-1) / (s.shape[-2] * size) for s in strata]
    return np.sum([part.sum(axis=-1) for part in parts], axis=0), parts


def iqm_parts(strata: Strata) -> tuple[Floats, list[Floats]]:
    """The interquartile mean, and winsorised contributions."""
    pooled = np.concatenate([s.reshape(*s.shape[:-2], -1) for s in strata], axis=-1)
    pooled.sort(axis=-1)
    cut = pooled.shape[-1] // 4
    middle = pooled[..., cut : pooled.shape[-1] - cut]
    low, high = middle[..., :1, None], middle[..., -1:, None]
    parts = [np.clip(s, low, high).sum(axis=-1) / middle.shape[-1] for s in strata]
    return middle.mean(axis=-1), parts


def difference_parts(strata: Strata) -> tuple[Floats, list[Floats]]:
    """The first method's mean less the second's."""
    half = len(strata) // 2
    (first, parts), (second, others) = mean_parts(strata[:half]), mean_parts(strata[half:])
    return first - second, parts + [-part for part in others]


def improvement_parts(strata: Strata) -> tuple[Floats, list[Floats]]:
    """The probability of improvement; a run contributes the share of its comparisons won."""
    half = len(strata) // 2
    size = sum(s.shape[-1] for s in strata[:half])
    firsts, seconds = [], []
    for a, b in zip(strata[:half], strata[half:], strict=True):
        won = (a[..., :, None, :] > b[..., None, :, :]).sum(axis=-1)  # (..., n, m); no ties
        firsts.append(won.mean(axis=-1) / (size * won.shape[-2]))
        seconds.append(won.mean(axis=-2) / (size * won.shape[-1]))
    return np.sum([part.sum(axis=-1) for part in firsts], axis=0), firsts + seconds


def probability_of_improvement(a: Floats, b: Floats) -> Interval:
    """The share of pairs of runs that the first method wins, averaged over environments.

    There are no ties. The interval is Wilson's for as many independent comparisons as the method
    with fewer runs has runs: the average over all pairs varies no more than that over comparisons
    without a run in common (Hoeffding, 1963, section 5). If no run is in two strata, each stratum's
    number is multiplied by all environments / its environments; the least of them counts.
    """
    pairs = zip(a.T, b.T, strict=True)
    won = [(x[~np.isnan(x), None] > y[~np.isnan(y)]).mean() for x, y in pairs]
    evaluated = ~np.isnan(np.concatenate([a, b]))  # (runs of both, environments)
    strata, sizes = np.unique(evaluated, axis=1, return_counts=True)  # columns with the same runs
    fewest = np.minimum(strata[: len(a)].sum(axis=0), strata[len(a) :].sum(axis=0))  # (strata,)
    if strata.sum(axis=1).max() == 1:  # no run is in two strata
        fewest = fewest * sizes.sum() / sizes
    return wilson_interval(float(np.mean(won)), float(fewest.min()))


def true_iqm(means: Floats) -> float:
    """The interquartile mean of infinitely many runs."""
    normal = ndtri((np.arange(4000) + 0.5) / 4000) * np.hypot(RUN_EFFECT, RESIDUAL)
    pooled = np.sort((means[:, None] + normal).ravel())
    return float(pooled[len(pooled) // 4 : len(pooled) * 3 // 4].mean())


def improvement(gain: float) -> Statistic:
    """The probability of improvement of a method that is better by `gain`."""
    spread = np.sqrt(2) * np.hypot(RUN_EFFECT, RESIDUAL)
    truth = NormalDist().cdf(gain / spread)
    return Statistic(
        probability_of_improvement, improvement_parts, lambda means: truth, (gain, 0.0)
    )


STATISTICS = {
    "mean": Statistic(statistics.mean, mean_parts, lambda means: float(means.mean())),
    "IQM": Statistic(statistics.interquartile_mean, iqm_parts, true_iqm),
    "difference 0.1": Statistic(
        statistics.difference, difference_parts, lambda means: 0.1, (0.1, 0.0), -1.0
    ),
    "P(better), 0.1 better": improvement(0.1),
    "P(better), 0.2 better": improvement(0.2),
}


def rollout_intervals(scores: Floats, rng: np.random.Generator, resamples: int) -> list[Bounds]:
    """Every kind of interval for the mean of one environment's rollouts."""
    ours = rollout_mean(scores)
    half = stdtrit(len(scores) - 1, TAILS[1]) * scores.std(ddof=1) / np.sqrt(len(scores))
    means = scores[rng.integers(len(scores), size=(resamples, len(scores)))].mean(axis=-1)
    return [
        (ours.low, ours.high),
        percentiles(means),
        (scores.mean() - half, scores.mean() + half),
    ]


def successes(probability: float) -> tuple[float, Callable[[np.random.Generator], Floats]]:
    return probability, lambda rng: (rng.random(ROLLOUTS) < probability).astype(np.float64)


ROLLOUT_SCORES = {
    **{f"success {p:.0%}": successes(p) for p in (0.5, 0.9, 0.97, 0.99)},
    "uniform scores": (0.5, lambda rng: rng.random(ROLLOUTS)),
    "1 in 97%, else uniform": (
        0.985,
        lambda rng: np.where(rng.random(ROLLOUTS) < 0.97, 1.0, rng.random(ROLLOUTS)),
    ),
    "1 in 97%, else 0.5": (0.985, lambda rng: np.where(rng.random(ROLLOUTS) < 0.97, 1.0, 0.5)),
    "0.5 in 98%, else 0": (0.49, lambda rng: np.where(rng.random(ROLLOUTS) < 0.98, 0.5, 0.0)),
    "0 in 90%, else 1/3": (1 / 30, lambda rng: np.where(rng.random(ROLLOUTS) < 0.9, 0.0, 1 / 3)),
}


if __name__ == "__main__":
    main()
