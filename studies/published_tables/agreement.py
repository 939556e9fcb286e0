"""Whether means over environments are equivalent to the published ones within a margin."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from magical.evaluation.statistics import Interval, mean, weighted_sum
from studies.published_tables.claims import DEMO, PARTS
from studies.published_tables.rows import MethodRuns, reproduced_row
from studies.published_tables.scale import published_contrast

MARGIN = 0.05  # about half of what augmentation is worth in the published tables
CONFIDENCE = 0.90  # with it, "equivalent" is two one-sided tests at 5% each


@dataclass(frozen=True, slots=True)
class Agreement:
    """A row's mean over a part of the environments beside the published one, on the same tasks.

    Attributes:
        method: meant to reproduce a published row.
        part: `Demo` or `test variants`.
        tasks: on which it was run.
        ours: with a 90% interval.
        published: with a 90% interval.
    """

    method: str
    part: str
    tasks: tuple[str, ...]
    ours: Interval
    published: Interval

    @property
    def difference(self) -> Interval:
        """Ours less the published mean."""
        return weighted_sum([self.ours, self.published], (1.0, -1.0))

    @property
    def verdict(self) -> str:
        """Whether the difference's interval is inside the margin, outside, or neither.

        If neither, whether it excludes 0.
        """
        found = self.difference
        if math.isnan(found.low):
            return "open: too few runs"
        if -MARGIN < found.low and found.high < MARGIN:
            return f"equivalent within {MARGIN}"
        if found.low > MARGIN or found.high < -MARGIN:
            return f"differs by more than {MARGIN}"
        return "differs; by how much is open" if found.low > 0.0 or found.high < 0.0 else "open"


def find_agreements(rows: Iterable[MethodRuns]) -> list[Agreement]:
    """Each row that is meant to reproduce a published one, on Demo and on the test variants."""
    return [_agreement(row, part) for row in rows if reproduced_row(row.method) for part in PARTS]


def _agreement(row: MethodRuns, part: str) -> Agreement:
    env_ids = [i for i in row.env_ids if (i.variant == DEMO) == (part == DEMO)]
    cells = [(i.task, i.variant) for i in env_ids]
    return Agreement(
        row.method,
        part,
        tuple(dict.fromkeys(i.task for i in env_ids)),
        mean(row.on(env_ids), CONFIDENCE),
        published_contrast({row.published: 1.0}, cells, CONFIDENCE),
    )
