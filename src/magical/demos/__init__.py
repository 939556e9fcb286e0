"""Demonstrations: trajectories, datasets, the published human ones, recording, export.

from magical.demos import Dataset, RecordTrajectories

dataset = Dataset.open("demos").filter(task="MoveToCorner", min_score=0.9)
arrays = dataset.arrays(preset="LoRes4E")
"""

from typing import TYPE_CHECKING, Any

from magical.demos.dataset import Dataset, Problem
from magical.demos.manifest import Entry
from magical.demos.trajectory import Trajectory
from magical.demos.writer import DatasetWriter

if TYPE_CHECKING:
    from magical.demos.drawing import Frames, ObservationReader, observations
    from magical.demos.record import RecordTrajectories

__all__ = [
    "Dataset",
    "DatasetWriter",
    "Entry",
    "Frames",
    "ObservationReader",
    "Problem",
    "RecordTrajectories",
    "Trajectory",
    "observations",
]

# These bring in the physics and drawing, and are imported when they are asked for.
_LATER = {
    "Frames": "drawing",
    "ObservationReader": "drawing",
    "RecordTrajectories": "record",
    "observations": "drawing",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
