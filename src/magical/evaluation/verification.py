"""Whether an entry's scores are what its policy gets: a sample of its rollouts, run again."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.errors import PolicyError
from magical.evaluation.entry import Entry
from magical.evaluation.intervals import CONFIDENCE, Interval, t_interval
from magical.evaluation.policy import Policy, is_privileged
from magical.evaluation.rollouts import evaluate_round, observation_again, observation_for
from magical.evaluation.scores import RolloutScore

TOLERANCE = 1e-9  # between scores that are the same


@dataclass(frozen=True, slots=True)
class Verification:
    """Scores of some rollouts as recorded and as they are now.

    Attributes:
        recorded: the entry's.
        again: of the same rollouts, in the same order.
        same_machine: whether the entry was evaluated on a machine and with versions like these, so
            that its scores should be the same to the bit.
    """

    recorded: Sequence[RolloutScore]
    again: Sequence[RolloutScore]
    same_machine: bool

    @property
    def changes(self) -> Sequence[float]:
        """The score now less the recorded one, of each rollout; the rule that changed it more."""
        return [
            max(now.score - old.score, now.published_code_score - old.published_code_score, key=abs)
            for old, now in zip(self.recorded, self.again, strict=True)
        ]

    @property
    def equal(self) -> int:
        """How many rollouts have the recorded scores."""
        return sum(abs(change) <= TOLERANCE for change in self.changes)

    @property
    def mean_change(self) -> Interval:
        """The mean change of the scores with a t interval over rollouts."""
        changes = np.array(self.changes)
        return t_interval(float(changes.mean()), [changes / len(changes)], CONFIDENCE, (-1.0, 1.0))

    @property
    def confirmed(self) -> bool:
        """Whether the scores are what they would be.

        On a machine like the entry's all must be equal. On another one the last bit of a network's
        arithmetic may tip sampled actions, and contact amplifies that: then the scores may differ,
        and their mean must not differ by more than chance.
        """
        if self.equal == len(self.recorded):
            return True
        change = self.mean_change
        return not self.same_machine and change.low <= 0.0 <= change.high

    def by_environment(self) -> dict[EnvId, "Verification"]:
        """The part of each environment."""
        ids = list(dict.fromkeys(row.env_id for row in self.recorded))
        pairs = list(zip(self.recorded, self.again, strict=True))
        return {
            env_id: Verification(
                [old for old, _ in pairs if old.env_id == env_id],
                [now for old, now in pairs if old.env_id == env_id],
                self.same_machine,
            )
            for env_id in ids
        }


def verify(
    entry: Entry,
    policy: Policy,
    *,
    rounds: int = 1,
    rng: np.random.Generator,
    same_machine: bool = False,
    workers: int | None = None,
) -> Verification:
    """Run a sample of an entry's rollouts again.

    Args:
        entry: the recorded scores.
        policy: that they are said to be of.
        rounds: how many of each task's rounds (`evaluate_round`) are run again.
        rng: chooses them.
        same_machine: see `Verification`.
        workers: processes.

    Raises:
        PolicyError: it is not shown what the entry says.
    """
    _check_policy(entry, policy)
    again = []
    for env_ids in _by_task(entry.scores):
        rollouts = 1 + max(row.rollout for row in entry.scores if row.env_id == env_ids[0])
        done: set[int] = set()
        for _ in range(rounds):
            left = sorted(set(range(rollouts)) - done)
            if not left:
                break
            scores = evaluate_round(
                policy,
                env_ids,
                int(rng.choice(left)),
                rollouts=rollouts,
                seed=entry.seed,
                horizon=entry.steps,
                nudge=entry.nudge,
                observation=observation_again(policy, entry.observation),
                workers=workers,
            )
            done |= {row.rollout for row in scores}
            again += scores
    recorded = {(row.env_id, row.rollout): row for row in entry.scores}
    return Verification([recorded[row.env_id, row.rollout] for row in again], again, same_machine)


def is_same_machine(
    details: Mapping[str, Any], machine: Mapping[str, str], versions: Mapping[str, str]
) -> bool:
    """Whether an entry's details record this machine and these versions; its name may differ."""
    recorded = details.get("machine")
    if not isinstance(recorded, dict) or details.get("versions") != dict(versions):
        return False
    return {**recorded, "name": ""} == {**machine, "name": ""}


def _check_policy(entry: Entry, policy: Policy) -> None:
    """Raise `PolicyError` where the policy is not shown what the entry says."""
    shown = str(observation_for(policy, observation_again(policy, entry.observation)))
    if is_privileged(policy) != entry.privileged:
        words = {True: "privileged", False: "not privileged"}
        raise PolicyError(
            f"expected a policy that is {words[entry.privileged]}, as the entry says, found one "
            f"that is {words[is_privileged(policy)]}"
        )
    if entry.observation and shown != entry.observation:
        raise PolicyError(
            f"expected a policy that is shown {entry.observation}, as the entry says, found one "
            f"that is shown {shown}"
        )


def _by_task(scores: Iterable[RolloutScore]) -> list[list[EnvId]]:
    """The environments of each task, in the entry's order."""
    groups: dict[str, list[EnvId]] = {}
    for env_id in dict.fromkeys(row.env_id for row in scores):
        groups.setdefault(env_id.task, []).append(env_id)
    return list(groups.values())
