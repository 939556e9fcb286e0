"""The result of a comparison with recordings."""

from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True, slots=True)
class Comparison:
    """One figure, its limit, and whether it keeps to the limit."""

    name: str
    figure: float
    limit: float
    unit: str
    passed: bool
    detail: str = ""

    @classmethod
    def at_most(cls, name: str, figure: float, limit: float, unit: str, detail: str = "") -> Self:
        """The comparison of a figure that passes up to `limit`."""
        return cls(name, figure, limit, unit, figure <= limit, detail)

    @classmethod
    def at_least(cls, name: str, figure: float, limit: float, unit: str, detail: str = "") -> Self:
        """The comparison of a figure that passes from `limit` upwards."""
        return cls(name, figure, limit, unit, figure >= limit, detail)
