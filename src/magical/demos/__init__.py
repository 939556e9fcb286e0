"""Demonstrations: datasets of trajectories, recording, the published human data, and export.

from magical.demos import Dataset, observations

for trajectory in Dataset.open("demos").filter(task="MoveToCorner", min_score=0.9):
    batch = observations(trajectory, "LoRes4E")
"""

from magical.demos.dataset import Dataset, DatasetWriter, Entry
from magical.demos.record import RecordTrajectories
from magical.demos.trajectory import Actor, Frames, Trajectory, TrajectorySource, observations

__all__ = [
    "Actor",
    "Dataset",
    "DatasetWriter",
    "Entry",
    "Frames",
    "RecordTrajectories",
    "Trajectory",
    "TrajectorySource",
    "observations",
]
