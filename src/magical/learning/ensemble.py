"""Several trained networks as one policy."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from magical.errors import PolicyError
from magical.evaluation.policy import Actions, Mask
from magical.learning.policy import NetworkPolicy, choose_actions, load_policy


class EnsemblePolicy:
    """Samples actions from the mean of several policies' distributions.

    Args:
        members: policies with the same observation. The ensemble's tasks are those they all share.

    Raises:
        PolicyError: no members, or members with different observations or no task in common.
    """

    def __init__(self, members: Sequence[NetworkPolicy]) -> None:
        observations = {member.observation for member in members}
        if len(observations) != 1:
            raise PolicyError(
                "ensemble: expected policies of one observation, found "
                f"{', '.join(sorted(observations)) or 'none'}"
            )
        self.members = tuple(members)
        self.observation = members[0].observation
        self.tasks = tuple(t for t in members[0].tasks if all(t in m.tasks for m in members))
        if not self.tasks:
            raise PolicyError("ensemble: expected policies with a task in common, found none")

    @classmethod
    def load(cls, runs: Sequence[Path | str], device: str = "auto") -> Self:
        """Load the policies of run folders; raises `PolicyError` and what `load_policy` raises."""
        members = []
        for run in runs:
            policy = load_policy(run, device)
            if not isinstance(policy, NetworkPolicy):
                raise PolicyError(f"ensemble: {run} gives no probabilities of single actions")
            members.append(policy)
        return cls(members)

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """One action for each environment, (B,) int64; raises what `NetworkPolicy.act` raises."""
        return choose_actions(self.probabilities(observations, env_ids), rng)

    def probabilities(self, observations: Any, env_ids: Sequence[str]) -> NDArray[np.float64]:
        """The mean distribution over actions, (B, 18) float64."""
        found = [member.probabilities(observations, env_ids) for member in self.members]
        mean: NDArray[np.float64] = np.mean(found, axis=0)
        return mean

    def reset(self, mask: Mask) -> None:
        """Do nothing, as the members have no memory."""
