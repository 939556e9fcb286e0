"""The scripted experts as a policy: an upper bound in every table."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.envs.action_spec import Actions, ActionSpaceName, action_spec
from magical.evaluation.policy import Mask
from magical.experts import Expert, expert_for, modules_of
from magical.experts.noise import check_share
from magical.scene import NUM_ACTIONS, State


class ExpertPolicy:
    """Each environment's scripted expert, with a strategy sampled for every episode.

    Args:
        skill: 1 acts as well as it can; below, it makes mistakes.
        random_share: the share of each episode, from its start, in which actions are uniformly
            random; then the expert takes over from wherever that led.
        action_space: "continuous" returns the same actions as points of that space.

    Raises:
        InvalidConfigError: a share or skill outside [0, 1].
        NoExpertError: a task has no expert; raised by the first `act`.
        UnknownNameError: there is no such action space.
    """

    privileged = True
    exact = True
    in_processes = True  # it is fast to start and costly to run

    def __init__(
        self,
        skill: float = 1.0,
        random_share: float = 0.0,
        action_space: ActionSpaceName = "discrete",
    ) -> None:
        check_share("skill", skill)
        check_share("random_share", random_share)
        self.skill = skill
        self.random_share = random_share
        self.action_space = action_space
        self._spec = action_spec(action_space)
        self._experts: list[Expert | None] = []
        self._memories: list[Any] = []

    def act(
        self, observations: Sequence[State], env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> Actions:
        """Each expert's action in the present state."""
        if any(expert is None for expert in self._experts):
            self._make_experts(env_ids, rng)
        random_steps = [int(self.random_share * state.horizon) for state in observations]
        actions = np.empty(len(env_ids), np.int64)
        if self.random_share:
            actions = rng.integers(NUM_ACTIONS, size=len(env_ids))
        for row, state in enumerate(observations):
            expert = self._experts[row]
            assert expert is not None
            if state.step >= random_steps[row]:
                actions[row], self._memories[row] = expert.act(state, self._memories[row])
        return self._spec.convert(actions)

    def reset(self, mask: Mask) -> None:
        """Drop the experts of the environments that begin an episode."""
        if len(mask) != len(self._experts):
            self._experts, self._memories = [None] * len(mask), [None] * len(mask)
        for row in np.flatnonzero(mask):
            self._experts[row] = self._memories[row] = None

    def __reduce__(self) -> tuple[type["ExpertPolicy"], tuple[float, float, ActionSpaceName]]:
        """A copy for another process has the settings, and no episode in progress."""
        return ExpertPolicy, (self.skill, self.random_share, self.action_space)

    def modules(self, tasks: Sequence[str]) -> list[str]:
        """The modules from which a new process learns of the tasks' experts."""
        return sorted({module for task in tasks for module in modules_of(task)})

    def _make_experts(self, env_ids: Sequence[EnvId], rng: np.random.Generator) -> None:
        seeds = rng.integers(2**31, size=len(env_ids))
        for row, expert in enumerate(self._experts):
            if expert is None:
                task, seed = env_ids[row].task, int(seeds[row])
                self._experts[row] = expert_for(task, seed=seed, skill=self.skill)
