"""Verifying an entry's scores by running a sample of its rollouts again.

This finds mistakes. A policy that was made to deceive, such as one that knows the public seeds'
scenes, does again what it did before.
"""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.errors import PolicyError, ScoresError
from magical.evaluation.entry import Entry, Record, RolloutScore
from magical.evaluation.policy import NO_OBSERVATION, Policy, observed
from magical.evaluation.rollouts import evaluate_round
from magical.evaluation.statistics import CONFIDENCE, Interval, t_interval
from magical.grouping import group_by

TOLERANCE = 1e-9  # the largest difference between equal scores


@dataclass(frozen=True, slots=True)
class Verification:
    """Scores of a sample of rollouts, as recorded and as obtained now.

    They must be equal unless a network acts on another machine or with other versions than the
    entry states: then the last bit of its arithmetic may change sampled actions, and contact
    amplifies that.
    """

    recorded: Sequence[RolloutScore]
    again: Sequence[RolloutScore]  # of the same rollouts, in the same order
    exact: bool  # whether all must be equal
    total: int  # rollouts in the entry

    @property
    def share(self) -> float:
        """The share of rollouts run again: the probability of finding one altered score."""
        return len(self.recorded) / self.total

    @property
    def changes(self) -> NDArray[np.float64]:
        """The new scores minus the recorded ones, (rollouts, 2): by each scoring rule."""
        now, then = (np.array([row[3:] for row in rows]) for rows in (self.again, self.recorded))
        changes: NDArray[np.float64] = now - then
        return changes

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


def verify(
    entry: Entry,
    policy: Policy,
    *,
    rounds: int = 1,
    rng: np.random.Generator,
    elsewhere: bool = False,
    workers: int | None = None,
) -> Verification:
    """Run a sample of an entry's rollouts again, after checking both scores of all of them.

    Of each task so many rounds (`evaluate_round`) are run again, chosen by `rng`; `elsewhere` says
    whether the entry was made elsewhere (`is_elsewhere`). A network uses as many CPU threads as the
    entry records, since another number may change the last bit of its arithmetic.

    Raises:
        PolicyError: the policy is not shown what the entry says.
        ScoresError: the two scores of a rollout differ on a task whose rules are the same.
    """
    for env_id, rollout, _, *both in entry.scores:
        if env_id.task_spec.published_score_fn is None and both[0] != both[1]:
            raise ScoresError(
                f"{env_id}, rollout {rollout}: expected equal scores by both rules, which are the "
                f"same on this task, found {both}"
            )
    evaluation = entry.evaluation(policy)
    now = observed(policy, evaluation.observation, evaluation.env_ids[0].task_spec)
    stated = entry.observation or now[0], entry.evaluated.privileged
    if now != stated and now[0] != NO_OBSERVATION:  # which needs no more than any other
        shown = [f"{name}, {'' if state else 'not '}privileged" for name, state in (stated, now)]
        raise PolicyError(
            f"expected a policy that is shown {shown[0]}, as the entry says, found {shown[1]}"
        )
    again: list[RolloutScore] = []
    threads, using = entry.record.threads, getattr(policy, "using_threads", None)
    with using(threads) if using and threads else nullcontext():
        for env_ids in evaluation.by_task.values():
            part, left = (
                replace(evaluation, env_ids=tuple(env_ids)),
                set(range(evaluation.rollouts)),
            )
            for _ in range(rounds):
                if left:
                    scores = evaluate_round(policy, part, int(rng.choice(sorted(left))), workers)
                    left -= {row.rollout for row in scores}
                    again += scores
    known = {(row.env_id, row.rollout): row for row in entry.scores}
    recorded = [known[row.env_id, row.rollout] for row in again]
    exact = not elsewhere or getattr(policy, "exact", False)
    return Verification(recorded, again, exact, len(entry.scores))


def is_elsewhere(record: Record, machine: Mapping[str, str], versions: Mapping[str, str]) -> bool:
    """Whether an entry states another machine or other versions than the given ones.

    False if it does not state both. The machine's name may differ, and there may be additional
    libraries now.
    """
    if not (record.machine.keys() >= machine.keys() and record.versions):
        return False
    same_machine = {**record.machine, "name": ""} == {**machine, "name": ""}
    return not (same_machine and record.versions.items() <= versions.items())
