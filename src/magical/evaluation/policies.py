"""Policies that come with the benchmark: random, no-op, expert, and a plain function."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from magical.evaluation.policy import Actions, Mask
from magical.scene import NOOP, NUM_ACTIONS


class RandomPolicy:
    """Every action with equal probability at every step."""

    observation = "state"  # unused: nothing is rendered

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """One uniform sample for each environment."""
        return rng.integers(NUM_ACTIONS, size=len(env_ids))

    def reset(self, mask: Mask) -> None:
        """Nothing to reset."""


class NoopPolicy:
    """The no-op at every step: the score of the scene itself."""

    observation = "state"

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """The no-op for each environment."""
        return np.full(len(env_ids), NOOP)

    def reset(self, mask: Mask) -> None:
        """Nothing to reset."""


class FunctionPolicy:
    """A policy without memory from a function `(observations, env_ids, rng) -> actions`.

    The function's own attributes `privileged`, `observation` and `tasks` are the policy's.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.privileged = bool(getattr(function, "privileged", False))
        self.observation = getattr(function, "observation", None)
        self.tasks = getattr(function, "tasks", None)

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """Call the function."""
        actions: Actions = self.function(observations, env_ids, rng)
        return actions

    def reset(self, mask: Mask) -> None:
        """Nothing to reset."""
