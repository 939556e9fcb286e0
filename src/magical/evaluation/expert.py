"""The scripted experts as a policy: an upper bound in every table."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.envs.action_spec import Actions, ActionSpaceName, action_spec
from magical.evaluation.policy import Mask
from magical.experts import EpisodeExpert, expert_for, modules_of
from magical.experts.noise import check_share
from magical.scene import NUM_ACTIONS, State


class ExpertPolicy:
    """Each environment's scripted expert, with a strategy sampled for every episode.

    Args:
        random_share: the share of each episode, from its start, in which actions are uniformly
            random; the expert then takes over from the state that this led to.
        action_space: with "continuous", the same actions are returned as points of that space.

    Raises:
        InvalidConfigError: a share outside [0, 1].
        NoExpertError: a task has no expert; raised by the first `act`.
    """

    privileged = True
    exact = True
    in_processes = True  # it is fast to start and costly to run
    record: Mapping[str, Any] = {"learned_from": []}

    def __init__(
        self, random_share: float = 0.0, action_space: ActionSpaceName = "discrete"
    ) -> None:
        check_share("random_share", random_share)
        self.random_share = random_share
        self.action_space = action_space
        self._spec = action_spec(action_space)
        self._experts: dict[int, EpisodeExpert] = {}  # by row of the batch

    def act(
        self, observations: Sequence[State], env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> Actions:
        """Each expert's action in the current state."""
        if new := [row for row in range(len(env_ids)) if row not in self._experts]:
            seeds = rng.integers(2**31, size=len(env_ids)).tolist()
            for row in new:
                expert = expert_for(env_ids[row].task, seed=seeds[row])
                self._experts[row] = EpisodeExpert(expert)
        actions = np.empty(len(env_ids), np.int64)
        if self.random_share:
            actions = rng.integers(NUM_ACTIONS, size=len(env_ids))
        for row, state in enumerate(observations):
            if state.step >= int(self.random_share * state.horizon):
                actions[row] = self._experts[row].act(state)
        return self._spec.convert(actions)

    def reset(self, mask: Mask) -> None:
        """Drop the experts of the environments that begin an episode."""
        for row in np.flatnonzero(mask).tolist():
            self._experts.pop(row, None)

    def __reduce__(self) -> tuple[type["ExpertPolicy"], tuple[float, ActionSpaceName]]:
        """A copy for another process has the settings, and no episode in progress."""
        return ExpertPolicy, (self.random_share, self.action_space)

    def modules(self, tasks: Sequence[str]) -> list[str]:
        """The modules that a new process must import to have the tasks' experts."""
        return sorted({module for task in tasks for module in modules_of(task)})
