"""Averages of metrics over steps."""

import time

from torch import Tensor


class Averages:
    """Weighted means of metrics since the last reset; sums stay on the metrics' device."""

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self._sums: dict[str, Tensor] = {}
        self._weights: dict[str, int] = {}
        self._start = time.perf_counter()

    def add(self, weight: int, **values: Tensor) -> None:
        """Add scalars with a weight, such as the number of samples that they average."""
        for name, value in values.items():
            weighted = value.detach() * weight
            self._sums[name] = self._sums[name] + weighted if name in self._sums else weighted
            self._weights[name] = self._weights.get(name, 0) + weight

    def reset(self, speed_of: str = "") -> dict[str, float]:
        """Return the means and start over.

        `speed_of`, the name of a metric whose weights count samples, adds samples per second.
        """
        means = {name: (total / self._weights[name]).item() for name, total in self._sums.items()}
        if speed_of:
            seconds = time.perf_counter() - self._start
            means["samples_per_second"] = self._weights[speed_of] / seconds
        self._clear()
        return means
