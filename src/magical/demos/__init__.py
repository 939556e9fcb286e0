"""Demonstrations: datasets of trajectories, recording, the published human data, and export.

from magical.demos import Dataset, RecordTrajectories

dataset = Dataset.open("demos").filter(task="MoveToCorner", min_score=0.9)
arrays = dataset.arrays(observation="LoRes4E")
"""

from magical.demos.dataset import Dataset, DatasetWriter, Entry
from magical.demos.reader import Frames, ObservationReader, observations
from magical.demos.record import RecordTrajectories
from magical.demos.trajectory import Actor, Trajectory

__all__ = [
    "Actor",
    "Dataset",
    "DatasetWriter",
    "Entry",
    "Frames",
    "ObservationReader",
    "RecordTrajectories",
    "Trajectory",
    "observations",
]
