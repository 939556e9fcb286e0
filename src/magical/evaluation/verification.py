"""Verifying an entry's scores by running a sample of its rollouts again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.errors import PolicyError
from magical.evaluation.entry import Entry
from magical.evaluation.intervals import CONFIDENCE, Interval, t_interval
from magical.evaluation.policy import NO_OBSERVATION, Policy, observed
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import evaluate_round
from magical.evaluation.scores import RolloutScore
from magical.grouping import group_by

TOLERANCE = 1e-9  # the largest difference between equal scores


@dataclass(frozen=True, slots=True)
class Verification:
    """Scores of a sample of rollouts, as recorded and as obtained now.

    Attributes:
        recorded: the entry's scores.
        again: the new scores of the same rollouts, in the same order.
        exact: whether all must be equal. They must unless a network acts on another machine or with
            other versions than the entry states: then the last bit of its arithmetic may change
            sampled actions, and contact amplifies that.
    """

    recorded: Sequence[RolloutScore]
    again: Sequence[RolloutScore]
    exact: bool

    @property
    def changes(self) -> NDArray[np.float64]:
        """The new scores minus the recorded ones, (rollouts, 2): by each scoring rule."""
        pairs = zip(self.recorded, self.again, strict=True)
        return np.array([np.subtract(_scores(now), _scores(old)) for old, now in pairs])

    @property
    def equal(self) -> int:
        """How many rollouts have the recorded scores."""
        return int((np.abs(self.changes) <= TOLERANCE).all(axis=1).sum())

    def mean_changes(self, confidence: float = CONFIDENCE) -> Sequence[Interval]:
        """The mean change by the appendix's rule, then by the published code's.

        Each has a t interval over rollouts, whose bounds are NaN if there is only one.
        """
        return [
            t_interval(float(changes.mean()), [changes / len(changes)], confidence, (-1.0, 1.0))
            for changes in self.changes.T
        ]

    @property
    def confirmed(self) -> bool:
        """Whether the recorded scores are confirmed.

        Unless all must be equal, the mean change over all rollouts, and over those of each
        environment with a changed score, must be within chance by both rules. `CONFIDENCE` is that
        of the two intervals over all rollouts together, and of all intervals of these environments
        together.
        """
        if self.exact or self.equal == len(self.recorded):
            return self.equal == len(self.recorded)
        parts = [part for part in self.by_environment().values() if part.equal < len(part.recorded)]
        changes = list(self.mean_changes(1.0 - (1.0 - CONFIDENCE) / 2))
        for part in parts:
            changes += part.mean_changes(1.0 - (1.0 - CONFIDENCE) / 2 / len(parts))
        return all(change.low <= 0.0 <= change.high for change in changes)

    def by_environment(self) -> dict[EnvId, "Verification"]:
        """The part for each environment."""
        pairs = group_by(zip(self.recorded, self.again, strict=True), lambda pair: pair[0].env_id)
        return {
            env_id: replace(self, recorded=[old for old, _ in part], again=[now for _, now in part])
            for env_id, part in pairs.items()
        }


def _scores(row: RolloutScore) -> tuple[float, float]:
    return row.score, row.published_code_score


def verify(
    entry: Entry,
    policy: Policy,
    *,
    rounds: int = 1,
    rng: np.random.Generator,
    elsewhere: bool = False,
    workers: int | None = None,
) -> Verification:
    """Run a sample of an entry's rollouts again.

    Args:
        entry: the recorded scores.
        policy: the policy that is said to have obtained them.
        rounds: how many of each task's rounds (`evaluate_round`) to run again.
        rng: chooses the rounds.
        elsewhere: see `is_elsewhere`.
        workers: processes.

    Raises:
        PolicyError: the policy is not shown what the entry says.
    """
    evaluation = entry.evaluation(policy)
    _check_policy(entry, policy, evaluation)
    again: list[RolloutScore] = []
    for env_ids in evaluation.by_task.values():
        part = replace(evaluation, env_ids=tuple(env_ids))
        left = set(range(evaluation.rollouts))
        for _ in range(rounds):
            if left:
                number = int(rng.choice(sorted(left)))
                scores = evaluate_round(policy, part, number, workers)
                left -= {row.rollout for row in scores}
                again += scores
    known = {(row.env_id, row.rollout): row for row in entry.scores}
    recorded = [known[row.env_id, row.rollout] for row in again]
    return Verification(recorded, again, not elsewhere or getattr(policy, "exact", False))


def is_elsewhere(
    details: Mapping[str, Any], machine: Mapping[str, str], versions: Mapping[str, str]
) -> bool:
    """Whether an entry's details state another machine or other versions than the given ones.

    False if they do not state both. The machine's name may differ, and there may be additional
    libraries now.
    """
    stated, libraries = details.get("machine"), details.get("versions")
    if not isinstance(stated, dict) or not isinstance(libraries, dict):
        return False
    if not (stated.keys() >= machine.keys() and libraries):
        return False
    same_machine = {**stated, "name": ""} == {**machine, "name": ""}
    return not (same_machine and libraries.items() <= versions.items())


def _check_policy(entry: Entry, policy: Policy, evaluation: Evaluation) -> None:
    """Raise `PolicyError` unless the policy is shown what the entry says."""
    shown, privileged = observed(policy, evaluation.observation, evaluation.env_ids[0].task_spec)
    if shown == NO_OBSERVATION:
        return  # it needs no more than whatever the entry says it was shown
    if privileged != entry.privileged:
        words = {True: "privileged", False: "not privileged"}
        raise PolicyError(
            f"expected a policy that is {words[entry.privileged]}, as the entry says, found one "
            f"that is {words[privileged]}"
        )
    if entry.observation and shown != entry.observation:
        raise PolicyError(
            f"expected a policy that is shown {entry.observation}, as the entry says, found one "
            f"that is shown {shown}"
        )
