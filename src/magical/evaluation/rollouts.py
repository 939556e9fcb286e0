"""Rollouts with fixed seeds: a policy, environments, scores."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidActionError, PolicyError
from magical.evaluation.loading import PolicySource, load_policy
from magical.evaluation.noise import reset_options
from magical.evaluation.policy import Mask, Policy, action_spec_of, given_to, observation_for
from magical.evaluation.protocol import ROLLOUTS, SEED, Evaluation, environments
from magical.evaluation.scores import RolloutScore
from magical.evaluation.seeds import RolloutRng
from magical.observe import Observation
from magical.processes import checked_workers, map_in_processes
from magical.tasks import Horizon, get_task, with_tasks
from magical.tasks.registry import defining_modules

NUM_ENVS = 64  # sub-environments stepped together: bounds the memory, hardly changes the speed
SHARE = 10  # rollouts of one environment that a process computes at a time

Progress = Callable[[int], None]  # called with the number of rollouts that have just ended


def evaluate(
    policy: PolicySource,
    env_ids: Iterable[str] | None = None,
    *,
    rollouts: int = ROLLOUTS,
    seed: int = SEED,
    observation: Observation = None,
    horizon: Horizon = None,
    nudge: float = 0.0,
    num_envs: int = NUM_ENVS,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[RolloutScore]:
    """Score a policy in environments, all variants of a task together.

    Rollout i of every environment is reset with `evaluation_seed(i, seed)` (docs/protocol.md).

    Args:
        policy: a policy, or anything that `load_policy` accepts.
        env_ids: one or more ids; by default all variants of the policy's own tasks, or of all.
        rollouts: the number of rollouts in each environment.
        seed: which set of fixed seeds; results are reported for 0.
        observation: by default the policy's own, or `LoRes4E`; states for a privileged policy.
        horizon: control steps; `"published"` for those of the published tables, which must differ
            from the appendix's for at least one of the tasks.
        nudge: the largest shift of initial poses, in units and radians, sampled from each rollout's
            seed; 1e-9 averages over what rounding decides on Demo (docs/determinism.md).
        num_envs: the most environments to step together (at least one for each environment id).
        workers: threads that step the environments, or for a policy with `in_processes` processes
            that run the policy too; by default one for each core.
        progress: called with the number of rollouts that have just ended.

    Returns:
        A score for each rollout, by environment in the given order, then by rollout.

    Raises:
        PolicyError: not a policy, or it returned something other than actions.
        UnknownNameError: an unknown environment, observation or policy, or no published horizon.
        ValueError: a horizon, nudge or seed out of range, or fewer than one rollout.
    """
    loaded = load_policy(policy)
    evaluation = Evaluation.of(
        environments(getattr(loaded, "tasks", None)) if env_ids is None else env_ids,
        rollouts=rollouts,
        seed=seed,
        observation=observation,
        horizon=horizon,
        nudge=nudge,
    )
    return roll_out(loaded, evaluation, num_envs=num_envs, workers=workers, progress=progress)


def roll_out(
    policy: Policy,
    evaluation: Evaluation,
    *,
    num_envs: int = NUM_ENVS,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[RolloutScore]:
    """Like `evaluate`, for an `Evaluation`; raises what `evaluate` does during rollouts."""
    run = _in_processes if getattr(policy, "in_processes", False) else _in_this_process
    return _collect(run(policy, evaluation, num_envs, workers), evaluation, progress)


def evaluate_round(
    policy: Policy, evaluation: Evaluation, number: int, workers: int | None = None
) -> list[RolloutScore]:
    """Repeat one round of an evaluation: all rollouts that were run together with a given one.

    The last bit of a network's arithmetic may depend on the batch size, which can change a sampled
    action. A round is batched as `evaluate` does it by default, so on the same machine its scores
    are the same.

    Args:
        policy: see `Policy`.
        evaluation: restricted to one task, with all of its environments in the original order.
        number: the number of the given rollout.
        workers: processes.
    """
    if getattr(policy, "in_processes", False):
        first = number - number % SHARE
        numbers = range(first, min(first + SHARE, evaluation.rollouts))
        shares = ((env_id, numbers) for env_id in evaluation.env_ids)
        return [row for share in shares for row in _score_share(policy, evaluation, share)]
    with _Rollouts(policy, evaluation, evaluation.env_ids, workers=workers) as batch:
        first = number - number % batch.copies
        numbers = range(first, min(first + batch.copies, evaluation.rollouts))
        return [row for part in batch.run(numbers) for row in part]


def _collect(
    parts: Iterable[Sequence[RolloutScore]], evaluation: Evaluation, progress: Progress | None
) -> list[RolloutScore]:
    """All scores, by environment in the given order, then by rollout."""
    scores: dict[EnvId, list[RolloutScore]] = {env_id: [] for env_id in evaluation.env_ids}
    for part in parts:
        for score in part:
            scores[score.env_id].append(score)
        if progress:
            progress(len(part))
    return [score for rows in scores.values() for score in rows]


def _in_this_process(
    policy: Policy, evaluation: Evaluation, num_envs: int, workers: int | None
) -> Iterator[list[RolloutScore]]:
    """Run the policy here, on all environments of a task at once; workers step them."""
    for group in evaluation.by_task.values():
        with _Rollouts(policy, evaluation, group, num_envs, workers) as batch:
            yield from batch.run(range(evaluation.rollouts))


def _in_processes(
    policy: Policy, evaluation: Evaluation, num_envs: int, workers: int | None
) -> Iterator[list[RolloutScore]]:
    """Run copies of the policy in several processes, each on a share of the rollouts."""
    shares = [
        (env_id, range(first, min(first + SHARE, evaluation.rollouts)))
        for env_id in evaluation.env_ids
        for first in range(0, evaluation.rollouts, SHARE)
    ]
    count = min(1 if workers is None else checked_workers(workers), len(shares))
    modules = modules_for(policy, list(evaluation.by_task)) if count > 1 else []
    score = with_tasks(partial(_score_share, policy, evaluation), modules)
    yield from map_in_processes(score, shares, count)


def modules_for(policy: Policy | None, tasks: Sequence[str]) -> list[str]:
    """The modules that a new process must import to have the tasks, and those the policy needs."""
    needed = getattr(policy, "modules", None)
    return [*defining_modules(list(map(get_task, tasks))), *(needed(tasks) if needed else [])]


def _score_share(
    policy: Policy, evaluation: Evaluation, share: tuple[EnvId, range]
) -> list[RolloutScore]:
    env_id, numbers = share
    part = replace(evaluation, rollouts=len(numbers))
    with _Rollouts(policy, part, [env_id], workers=0) as batch:
        return [score for rows in batch.run(numbers) for score in rows]


class RepeatedEvaluation:
    """An evaluation that is repeated, as during training: its environments are kept alive.

    Args:
        policy: see `Policy`; not one with `in_processes`.
        evaluation: how it is evaluated.
        workers: threads.
    """

    def __init__(self, policy: Policy, evaluation: Evaluation, workers: int | None = None) -> None:
        groups = evaluation.by_task.values()
        self._evaluation = evaluation
        with ExitStack() as stack:
            self._batches = [
                stack.enter_context(_Rollouts(policy, evaluation, group, workers=workers))
                for group in groups
            ]
            self._stack = stack.pop_all()

    def scores(self) -> list[RolloutScore]:
        """The score of each rollout, as `evaluate` returns them."""
        numbers = range(self._evaluation.rollouts)
        parts = (part for batch in self._batches for part in batch.run(numbers))
        return _collect(parts, self._evaluation, None)

    def close(self) -> None:
        """Close the environments."""
        self._stack.close()


def play(
    policy: Policy,
    envs: MagicalVectorEnv,
    seeds: Sequence[int],
    nudge: float = 0.0,
    active: Mask | None = None,
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Play one episode in each active sub-environment (by default all), in lockstep.

    Yields the observations and infos of the reset, then of every step.
    """
    rng = RolloutRng(envs.env_ids, seeds)
    options = reset_options(envs.env_ids, seeds, nudge)
    observations, infos = envs.reset(seed=list(seeds), options=options)
    policy.reset(np.ones(len(seeds), np.bool_))
    yield observations, infos
    ended = False
    while not ended:
        given = given_to(policy, envs, observations)
        actions = policy.act(given, envs.env_ids, rng)
        try:
            observations, _, _, truncated, infos = envs.step(actions, active)
        except InvalidActionError as error:
            raise PolicyError(f"policy: act(): {error}") from error
        ended = bool(truncated.any())
        yield observations, infos


class _Rollouts:
    """Environments of one task, each with several copies, whose episodes run in lockstep.

    Episodes end at the horizon and never before, so all begin and end together. If the last round
    has fewer rollouts than copies, the remaining copies are inactive.
    """

    def __init__(
        self,
        policy: Policy,
        evaluation: Evaluation,
        env_ids: Sequence[EnvId],
        num_envs: int = NUM_ENVS,
        workers: int | None = None,
    ) -> None:
        rounds = -(-evaluation.rollouts // max(1, num_envs // len(env_ids)))
        self.copies = -(-evaluation.rollouts // rounds)  # of each environment
        self.policy = policy
        self.seed = evaluation.seed
        self.nudge = evaluation.nudge
        self.envs = MagicalVectorEnv(
            [env_id for env_id in env_ids for _ in range(self.copies)],
            workers=workers,
            observation=observation_for(policy, evaluation.observation),
            horizon=evaluation.horizon,  # observations are copies: the policy may change them
            action_space=action_spec_of(policy).name,
        )

    def __enter__(self) -> "_Rollouts":
        return self

    def __exit__(self, *error: object) -> None:
        self.envs.close()

    def run(self, numbers: range) -> Iterator[list[RolloutScore]]:
        """The scores of the rollouts with these numbers in every environment, round by round."""
        for first in numbers[:: self.copies]:
            each = np.arange(first, first + self.copies)
            rollouts = np.tile(each, self.envs.num_envs // self.copies)
            active = rollouts < numbers.stop
            seeds = [evaluation_seed(number, self.seed) for number in rollouts.tolist()]
            for _, infos in play(self.policy, self.envs, seeds, self.nudge, active):
                final = infos
            scores, published = final["eval_score"], final["published_code_score"]
            yield [
                RolloutScore(
                    self.envs.env_ids[row],
                    int(rollouts[row]),
                    seeds[row],
                    float(scores[row]),
                    float(published[row]),
                )
                for row in np.flatnonzero(active).tolist()
            ]
