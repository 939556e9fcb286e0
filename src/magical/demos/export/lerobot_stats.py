"""The statistics that a LeRobotDataset has of every feature."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stats:
    """Least, greatest, mean and standard deviation, and of how many values."""

    min: Floats  # (D,), or (3, 1, 1) for cameras, on [0, 1]
    max: Floats
    mean: Floats
    std: Floats
    count: NDArray[np.int64]  # (1,)

    @staticmethod
    def of(values: NDArray[Any]) -> "Stats":
        """Of a column (T,) or (T, D)."""
        table = values.reshape(len(values), -1).astype(np.float64)
        return Stats(
            table.min(0), table.max(0), table.mean(0), table.std(0), np.array([len(table)])
        )

    @staticmethod
    def of_frames(frames: NDArray[np.uint8]) -> "Stats":
        """Of pictures (T, H, W, 3): each channel over all pixels, scaled to [0, 1]."""
        counts = np.stack([np.bincount(frames[..., c].ravel(), minlength=256) for c in range(3)])
        levels = np.arange(256) / 255.0
        share = counts / counts.sum(1, keepdims=True)
        mean = share @ levels
        deviation = np.sqrt((share * (levels - mean[:, None]) ** 2).sum(1))
        seen = [np.flatnonzero(row) / 255.0 for row in counts]
        least, most = np.array([row[0] for row in seen]), np.array([row[-1] for row in seen])
        cube = (3, 1, 1)
        return Stats(
            least.reshape(cube),
            most.reshape(cube),
            mean.reshape(cube),
            deviation.reshape(cube),
            np.array([len(frames)]),
        )

    def plain(self) -> dict[str, Any]:
        """Lists, for JSON and Parquet."""
        return {field.name: getattr(self, field.name).tolist() for field in fields(self)}


def merged(episodes: Sequence[dict[str, Stats]]) -> dict[str, Stats]:
    """The statistics of all episodes together, from those of each."""
    return {name: _merge([episode[name] for episode in episodes]) for name in episodes[0]}


def _merge(parts: list[Stats]) -> Stats:
    counts = np.concatenate([part.count for part in parts])
    weights = (counts / counts.sum()).reshape(-1, *([1] * parts[0].mean.ndim))
    means = np.stack([part.mean for part in parts])
    mean = (weights * means).sum(0)
    squares = np.stack([part.std**2 for part in parts]) + (means - mean) ** 2
    return Stats(
        np.min([part.min for part in parts], axis=0),
        np.max([part.max for part in parts], axis=0),
        mean,
        np.sqrt((weights * squares).sum(0)),
        counts.sum(keepdims=True),
    )
