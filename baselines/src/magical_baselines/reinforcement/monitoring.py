"""Metrics logged in addition to the losses: recent scores, warnings of a collapse, durations."""

import time
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from torch import Tensor

from magical_baselines.reinforcement.rollouts import EpisodeScores
from magical_baselines.running.checkpoints import StateDict

RECENT_EPISODES = 100  # over which the logged score is averaged
COLLAPSE_UPDATES = 50  # consecutive updates with a symptom before a warning
CHANCE = 0.5
NEAR_CHANCE = 0.05  # a discriminator's accuracy this close to chance counts as chance

Metrics = dict[str, float | str]


class Monitor:
    """Collects the scores and durations of updates, and warns of a collapse."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, float]] = deque(maxlen=RECENT_EPISODES)
        self._counts: dict[str, int] = {}  # consecutive updates with each symptom
        self._seconds: dict[str, float] = {}
        self._one_action = False

    def add_rollout(self, actions: Tensor, scores: EpisodeScores) -> None:
        """Add the scores of finished episodes, and check whether the actions (T, N) differ."""
        self._recent.extend(scores)
        self._one_action = bool((actions == actions[0, 0]).all())

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Measure the duration of a part of the update."""
        start = time.perf_counter()
        yield
        self._seconds[part] = time.perf_counter() - start

    def metrics(self) -> Metrics:
        """Durations in seconds and, once an episode has ended, the mean score."""
        found: Metrics = {f"{part}_seconds": spent for part, spent in self._seconds.items()}
        if self._recent:
            found["score"] = mean_by_task(self._recent)
        return found

    def warning(self, metrics: Mapping[str, float | str]) -> Metrics:
        """Return `{"warning": ...}` if one more update's metrics show a collapse, else `{}`."""
        accuracy = metrics.get("discriminator_accuracy")
        symptoms = {"one action": self._one_action}
        if isinstance(accuracy, float):
            symptoms["discriminator at chance"] = abs(accuracy - CHANCE) <= NEAR_CHANCE
            symptoms["discriminator always right"] = accuracy == 1.0
        counts = {name: self._counts.get(name, 0) + 1 for name, on in symptoms.items() if on}
        self._counts = counts
        found = [f"{name} for {n} updates" for name, n in counts.items() if n >= COLLAPSE_UPDATES]
        return {"warning": ", ".join(found)} if found else {}

    def state_dict(self) -> StateDict:
        """Recent scores, and for how many updates each symptom of a collapse has lasted."""
        return {"recent": list(self._recent), "collapse": self._counts}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self._recent.extend((int(task), score) for task, score in state["recent"])
        self._counts = {name: int(count) for name, count in state["collapse"].items()}


def mean_by_task(scores: Collection[tuple[int, float]]) -> float:
    """The mean over tasks of each task's mean score."""
    tasks = {task for task, _ in scores}
    means = [np.mean([score for t, score in scores if t == task]) for task in tasks]
    return float(np.mean(means))


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """1 - Var[returns - values] / Var[returns], both (B,); 0 if the returns do not vary."""
    variance = returns.var(correction=0)
    residual = (returns - values).var(correction=0)
    return (1.0 - residual / variance).item() if variance > 0 else 0.0
