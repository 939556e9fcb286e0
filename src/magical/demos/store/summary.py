"""Summaries of a dataset, and duplicates in it."""

from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import ManifestEntry
from magical.envs.action_spec import Actions, ActionSpaceName
from magical.grouping import group_by
from magical.scene import ACTION_NAMES, NUM_ACTIONS
from magical.scene.actions import POINTS


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
    action_spaces: tuple[ActionSpaceName, ...]  # kinds of actions found
    actions: tuple[int, ...]  # count of each of the 18; continuous ones count if equal

    @property
    def action_frequencies(self) -> list[tuple[str, float]]:
        """Names of the discrete actions taken and their shares of all steps, largest first."""
        total = round(self.count * self.lengths[1])
        order = np.argsort(self.actions, kind="stable")[::-1]
        return [(ACTION_NAMES[i], self.actions[i] / total) for i in order if self.actions[i]]


def summarise_dataset(dataset: Dataset) -> list[DatasetSummary]:
    """A summary for each environment, sorted by id; reads every trajectory once.

    Raises:
        DatasetError: a trajectory is damaged; `Dataset.open(..., skip_damaged=True)` leaves damaged
            ones out.
    """
    groups = group_by(dataset.entries, attrgetter("env_id"))
    return [_summary(Dataset(dataset.path, groups[env_id])) for env_id in sorted(groups)]


def find_duplicates(entries: Iterable[ManifestEntry]) -> list[tuple[str, str]]:
    """Pairs (later, earlier) in one environment with the same actions and poses or frames.

    Each is given by the name of its source or file.
    """
    first: dict[tuple[str, str], ManifestEntry] = {}
    pairs = []
    for entry in entries:
        earlier = first.setdefault((str(entry.env_id), entry.fingerprint), entry)
        if earlier is not entry:
            pairs.append((entry.source or entry.file, earlier.source or earlier.file))
    return pairs


def _summary(part: Dataset) -> DatasetSummary:
    entries = part.entries
    lengths = [entry.length for entry in entries]
    scores = [entry.score for entry in entries if entry.score is not None]
    actions, labelled = np.zeros(NUM_ACTIONS, np.int64), 0
    spaces: set[ActionSpaceName] = set()
    for trajectory in part:
        spaces.add(trajectory.action_space)
        actions += _counts(trajectory.actions)
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
        action_spaces=tuple(sorted(spaces)),
        actions=tuple(actions.tolist()),
    )


def _counts(actions: Actions) -> NDArray[np.int64]:
    """How often each of the 18 discrete actions occurs among actions of either kind, (18,)."""
    if actions.ndim == 1:
        return np.bincount(actions.astype(np.int64), minlength=NUM_ACTIONS)
    counts: NDArray[np.int64] = (actions[:, None] == POINTS).all(axis=-1).sum(axis=0)
    return counts
