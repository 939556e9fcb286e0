"""The scripted experts as a policy: an upper bound in every table."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.evaluation.policy import Actions, Mask
from magical.experts import Expert, expert_for
from magical.scene import State


class ExpertPolicy:
    """Each environment's scripted expert, with a strategy sampled for every episode.

    Raises `UnknownNameError` where a task has no expert.
    """

    privileged = True

    def __init__(self, skill: float = 1.0) -> None:
        self.skill = skill
        self._experts: list[Expert | None] = []
        self._memories: list[Any] = []

    def act(
        self, observations: Sequence[State], env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> Actions:
        """Each expert's action in the present state."""
        if any(expert is None for expert in self._experts):
            self._make_experts(env_ids, rng)
        actions = np.empty(len(env_ids), np.int64)
        for row, state in enumerate(observations):
            expert = self._experts[row]
            assert expert is not None
            actions[row], self._memories[row] = expert.act(state, self._memories[row])
        return actions

    def reset(self, mask: Mask) -> None:
        """Drop the experts of the environments that begin an episode."""
        if len(mask) != len(self._experts):
            self._experts, self._memories = [None] * len(mask), [None] * len(mask)
        for row in np.flatnonzero(mask):
            self._experts[row] = self._memories[row] = None

    def _make_experts(self, env_ids: Sequence[EnvId], rng: np.random.Generator) -> None:
        seeds = rng.integers(2**31, size=len(env_ids))
        for row, expert in enumerate(self._experts):
            if expert is None:
                task = env_ids[row].task
                self._experts[row] = expert_for(task, seed=int(seeds[row]), skill=self.skill)
