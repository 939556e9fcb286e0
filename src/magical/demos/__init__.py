"""Demonstrations: datasets of trajectories, recording, the published human data, and export.

from magical.demos import Dataset, RecordTrajectories

dataset = Dataset.open("demos").filter(task="MoveToCorner", min_score=0.9)
arrays = dataset.arrays(observation="LoRes4E")
"""

from magical.demos.record import RecordTrajectories
from magical.demos.store.dataset import Dataset, Problem
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.reader import Frames, ObservationReader, observations
from magical.demos.store.trajectory import Actor, Trajectory
from magical.demos.store.writer import DatasetWriter

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
