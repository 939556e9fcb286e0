"""Demonstrations: datasets of trajectories, recording, the published human ones, export.

from magical.demos import Dataset, RecordTrajectories

dataset = Dataset.open("demos").filter(task="MoveToCorner", min_score=0.9)
arrays = dataset.arrays(observation="LoRes4E")
"""

from typing import TYPE_CHECKING, Any

from magical.demos.store.dataset import Dataset, Problem
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.trajectory import Actor, Trajectory
from magical.demos.store.writer import DatasetWriter

if TYPE_CHECKING:
    from magical.demos.record import RecordTrajectories
    from magical.demos.store.reader import Frames, ObservationReader, observations

__all__ = [
    "Actor",
    "Dataset",
    "DatasetWriter",
    "Frames",
    "ManifestEntry",
    "ObservationReader",
    "Problem",
    "RecordTrajectories",
    "Trajectory",
    "observations",
]

# These import the physics and the renderer, so they are imported on first use.
_LAZY = {
    "Frames": "store.reader",
    "ObservationReader": "store.reader",
    "RecordTrajectories": "record",
    "observations": "store.reader",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
