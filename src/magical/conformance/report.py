"""What a comparison with recordings says."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Line:
    """One figure held against its limit."""

    name: str
    figure: float
    limit: float
    unit: str
    passed: bool
    detail: str = ""
