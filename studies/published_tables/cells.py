"""One environment of one row: our runs, the published ones, and how far they are apart."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from magical.evaluation.published import PUBLISHED_RUNS, published_table
from magical.evaluation.statistics import Floats, Spread
from magical.tasks.axes import short_variant
from studies.published_tables.rows import MethodRuns
from studies.published_tables.scale import pooled_std

LIMITS = (1, 2)  # pooled standard deviations


@dataclass(frozen=True, slots=True)
class ComparedCell:
    """A mean of ours beside a published one.

    Attributes:
        task: the task's name.
        variant: short, such as `Jitter`.
        means: (runs,), each run's mean score.
        published: the published mean and standard deviation.
    """

    task: str
    variant: str
    means: Floats
    published: Spread

    @property
    def mean(self) -> float:
        """Over our runs."""
        return float(self.means.mean())

    @property
    def std(self) -> float:
        """The sample standard deviation of our runs; NaN for one run."""
        return float(self.means.std(ddof=1)) if len(self.means) > 1 else math.nan

    @property
    def distance(self) -> float:
        """Our mean less the published one, in pooled standard deviations."""
        return (self.mean - self.published.mean) / pooled_std(self.means, self.published)

    def chance(self, limit: float) -> float:
        """How probable a distance of at most `limit` is if all runs are samples of one normal."""
        from scipy.special import stdtr  # slow to import

        ours = len(self.means)
        t = limit * math.sqrt(ours * PUBLISHED_RUNS / (ours + PUBLISHED_RUNS))
        return float(1.0 - 2.0 * stdtr(ours + PUBLISHED_RUNS - 2, -t))


@dataclass(frozen=True, slots=True)
class Count:
    """How many cells are how far from the published ones.

    Attributes:
        cells: all.
        within: those within one and within two pooled standard deviations.
        expected: how many would be, if all runs were samples of one normal distribution.
        below: those more than two below the published.
        above: those more than two above.
    """

    cells: int
    within: tuple[int, ...]
    expected: tuple[float, ...]
    below: tuple[ComparedCell, ...]
    above: tuple[ComparedCell, ...]


def make_cells(row: MethodRuns) -> list[ComparedCell]:
    """The cells of a row that has a published one, by task; those the tables have."""
    table = published_table()
    cells = []
    for env_id in row.env_ids:
        variant = short_variant(env_id.variant)
        spread = table.get((env_id.task, row.published, variant))
        if spread is not None:
            cells.append(ComparedCell(env_id.task, variant, row.runs_in(env_id), spread))
    return cells


def count(cells: Iterable[ComparedCell]) -> Count:
    """Count the cells within `LIMITS` of the published ones, and list those beyond the last."""
    cells = list(cells)
    far = LIMITS[-1]
    return Count(
        len(cells),
        tuple(sum(abs(cell.distance) <= limit for cell in cells) for limit in LIMITS),
        tuple(sum(cell.chance(limit) for cell in cells) for limit in LIMITS),
        _sorted(cell for cell in cells if cell.distance < -far),
        _sorted(cell for cell in cells if cell.distance > far),
    )


def distance_text(value: float) -> str:
    """A distance in pooled standard deviations, such as `−1.3`."""
    rounded = round(value, 1) or 0.0  # without a sign
    return f"{rounded:+.1f}".replace("-", "−") if rounded else "0.0"


def _sorted(cells: Iterable[ComparedCell]) -> tuple[ComparedCell, ...]:
    return tuple(sorted(cells, key=lambda cell: -abs(cell.distance)))
