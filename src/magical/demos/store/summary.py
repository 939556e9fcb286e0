"""Summaries of a dataset, and duplicates in it."""

from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import ManifestEntry
from magical.grouping import group_by
from magical.scene import ACTION_NAMES, NUM_ACTIONS


@dataclass(frozen=True, slots=True)
class DatasetSummary:
    """Statistics of the trajectories of one environment."""

    env_id: str
    count: int
    with_poses: int
    with_expert_actions: int
    demonstrators: tuple[str, ...]
    lengths: tuple[int, float, int]  # control steps: minimum, mean, maximum
    score: float | None  # mean of the known scores by the appendix's rule
    published_code_score: float  # mean
    size: int  # bytes on disk
    actions: tuple[int, ...]  # count of each of the 18

    @property
    def action_frequencies(self) -> list[tuple[str, float]]:
        """Names of the actions taken and their relative frequencies, most frequent first."""
        total = sum(self.actions)
        order = np.argsort(self.actions, kind="stable")[::-1]
        return [(ACTION_NAMES[i], self.actions[i] / total) for i in order if self.actions[i]]


def summarise_dataset(dataset: Dataset) -> list[DatasetSummary]:
    """A summary for each environment, sorted by id; reads every trajectory once.

    Raises:
        DatasetError: a trajectory is damaged; `Dataset.open(..., skip_damaged=True)` leaves those
            out.
    """
    groups = group_by(dataset.entries, attrgetter("env_id"))
    return [_summary(Dataset(dataset.path, groups[env_id])) for env_id in sorted(groups)]


def find_duplicates(entries: Iterable[ManifestEntry]) -> list[tuple[str, str]]:
    """Pairs (later, earlier) with the same actions and poses or frames, by source or file."""
    first: dict[str, ManifestEntry] = {}
    pairs = []
    for entry in entries:
        earlier = first.setdefault(entry.fingerprint, entry)
        if earlier is not entry:
            pairs.append((entry.source or entry.file, earlier.source or earlier.file))
    return pairs


def _summary(part: Dataset) -> DatasetSummary:
    entries = part.entries
    lengths = [entry.length for entry in entries]
    scores = [entry.score for entry in entries if entry.score is not None]
    actions, labelled = np.zeros(NUM_ACTIONS, np.int64), 0
    for trajectory in part:
        actions += np.bincount(trajectory.actions, minlength=NUM_ACTIONS)
        labelled += trajectory.expert_actions is not None
    return DatasetSummary(
        env_id=entries[0].env_id,
        count=len(entries),
        with_poses=sum(entry.has_poses for entry in entries),
        with_expert_actions=labelled,
        demonstrators=tuple(sorted({entry.demonstrator for entry in entries})),
        lengths=(min(lengths), float(np.mean(lengths)), max(lengths)),
        score=float(np.mean(scores)) if scores else None,
        published_code_score=float(np.mean([entry.published_code_score for entry in entries])),
        size=sum(entry.size for entry in entries),
        actions=tuple(actions.tolist()),
    )
