"""Policies that come with the benchmark: random, no-op, expert, and a plain function."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from magical.evaluation.policy import Actions, Mask
from magical.scene import NOOP, NUM_ACTIONS


class RandomPolicy:
    """Every action with equal probability at every step."""

    observation = "state"  # looks at nothing: let nothing be drawn

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """One uniform draw for each world."""
        return rng.integers(NUM_ACTIONS, size=len(env_ids))

    def reset(self, mask: Mask) -> None:
        """Nothing to forget."""


class NoopPolicy:
    """Stands still, fingers open: what a scene scores when nobody acts."""

    observation = "state"

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """The no-op for each world."""
        return np.full(len(env_ids), NOOP)

    def reset(self, mask: Mask) -> None:
        """Nothing to forget."""


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
        """Ask the function."""
        actions: Actions = self.function(observations, env_ids, rng)
        return actions

    def reset(self, mask: Mask) -> None:
        """Nothing to forget."""
