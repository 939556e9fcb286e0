"""Rollouts with fixed seeds: a policy, environments, scores."""

import functools
import inspect
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidActionError, PolicyError
from magical.evaluation.entry import RolloutScore
from magical.evaluation.policy import (
    NO_OBSERVATION,
    Mask,
    Policy,
    action_spec_of,
    is_privileged,
    load_policy,
    observation_for,
)
from magical.evaluation.protocol import ROLLOUTS, SEED, Evaluation, environments, reset_options
from magical.observe import Observation
from magical.processes import checked_workers, map_in_processes
from magical.tasks import Horizon, get_task, with_tasks
from magical.tasks.registry import defining_modules

NUM_ENVS = 64  # sub-environments stepped together: bounds the memory, hardly changes the speed
SHARE = 10  # rollouts of one environment that a process computes at a time

Progress = Callable[[int], None]  # called with the number of rollouts that have just ended


def evaluate(
    policy: object,
    env_ids: Iterable[str] | None = None,
    *,
    rollouts: int = ROLLOUTS,
    seed: int = SEED,
    observation: Observation = None,
    horizon: Horizon = None,
    nudge: float = 0.0,
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
        horizon: control steps, or "published"; by default the appendix's. See `Evaluation`.
        nudge: evaluation noise in units and radians. See `Evaluation`.
        workers: threads that step the environments, or for a policy with `in_processes` processes
            that run the policy too; by default a thread for each core, or one process.
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
    return roll_out(loaded, evaluation, workers=workers, progress=progress)


def roll_out(
    policy: Policy,
    evaluation: Evaluation,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[RolloutScore]:
    """Like `evaluate`, for an `Evaluation`; raises what `evaluate` does during rollouts."""
    batches = _batches(policy, evaluation)
    parts: Iterable[list[RolloutScore]]
    if getattr(policy, "in_processes", False):
        count = min(1 if workers is None else checked_workers(workers), len(batches))
        modules = modules_for(policy, list(evaluation.by_task)) if count > 1 else []
        work = with_tasks(functools.partial(_score_batch, policy, evaluation), modules)
        parts = map_in_processes(work, batches, count)
    else:
        parts = (part for each in batches for part in _rounds(policy, evaluation, each, workers))
    scores: dict[EnvId, list[RolloutScore]] = {env_id: [] for env_id in evaluation.env_ids}
    for part in parts:
        for score in part:
            scores[score.env_id].append(score)
        if progress:
            progress(len(part))
    return [score for rows in scores.values() for score in rows]


def evaluate_round(
    policy: Policy, evaluation: Evaluation, number: int, workers: int | None = None
) -> list[RolloutScore]:
    """Repeat one round of an evaluation: all rollouts that were run together with number `number`.

    The last bit of a network's arithmetic may depend on the batch size, which can change a sampled
    action. A round is batched as `evaluate` does it, so on the same machine its scores are the
    same. `evaluation` is restricted to one task, with all of its environments in the original
    order.
    """
    batches = [each for each in _batches(policy, evaluation) if number in each[1]]
    rounds = (_rounds(policy, evaluation, each, workers, number) for each in batches)
    return [row for parts in rounds for part in parts for row in part]


def modules_for(policy: Policy | None, tasks: Sequence[str]) -> list[str]:
    """The modules that a new process must import to have the tasks, and those the policy needs."""
    needed = getattr(policy, "modules", None)
    return [*defining_modules(list(map(get_task, tasks))), *(needed(tasks) if needed else [])]


Batch = tuple[Sequence[EnvId], range]  # environments of one task, and numbers of their rollouts


def _batches(policy: Policy, evaluation: Evaluation) -> list[Batch]:
    """What is computed at a time: a task, or by a process a share of one environment's rollouts."""
    numbers = range(evaluation.rollouts)
    if not getattr(policy, "in_processes", False):
        return [(env_ids, numbers) for env_ids in evaluation.by_task.values()]
    shares = [numbers[first : first + SHARE] for first in numbers[::SHARE]]
    return [([env_id], share) for env_id in evaluation.env_ids for share in shares]


def _score_batch(policy: Policy, evaluation: Evaluation, batch: Batch) -> list[RolloutScore]:
    return [row for part in _rounds(policy, evaluation, batch, workers=0) for row in part]


def _rounds(
    policy: Policy,
    evaluation: Evaluation,
    batch: Batch,
    workers: int | None,
    only: int | None = None,
) -> Iterator[list[RolloutScore]]:
    """The scores of a batch, round by round.

    In a round, several copies of each environment run in lockstep: episodes end at the horizon and
    never before, so all begin and end together. If the last round has fewer rollouts than copies,
    the remaining copies are inactive. With `only`, it is the round of this rollout alone.
    """
    env_ids, numbers = batch
    rounds = -(-len(numbers) // max(1, NUM_ENVS // len(env_ids)))
    copies = -(-len(numbers) // rounds)  # of each environment
    envs = MagicalVectorEnv(
        [env_id for env_id in env_ids for _ in range(copies)],
        workers=workers,
        observation=observation_for(policy, evaluation.observation),
        horizon=evaluation.horizon,  # observations are copies: the policy may change them
        action_space=action_spec_of(policy).name,
    )
    with closing(envs):
        for first in numbers[::copies]:
            if only is not None and only not in range(first, first + copies):
                continue
            rollouts = np.tile(np.arange(first, first + copies), len(env_ids)).tolist()
            active = np.array(rollouts) < numbers.stop
            seeds = [evaluation_seed(number, evaluation.seed) for number in rollouts]
            for _, infos in play(policy, envs, seeds, evaluation.nudge, active):
                final = infos
            scores, published = final["eval_score"].tolist(), final["published_code_score"].tolist()
            rows = zip(envs.env_ids, rollouts, seeds, scores, published, strict=True)
            yield [RolloutScore(*row) for row, runs in zip(rows, active, strict=True) if runs]


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
    needs_none = getattr(policy, "observation", None) == NO_OBSERVATION
    ended = False
    while not ended:
        shown = envs.states() if is_privileged(policy) else None if needs_none else observations
        actions = policy.act(shown, envs.env_ids, rng)
        try:
            observations, _, _, truncated, infos = envs.step(actions, active)
        except InvalidActionError as error:
            raise PolicyError(f"policy: act(): {error}") from error
        ended = bool(truncated.any())
        yield observations, infos


def rollout_stream(env_id: str, seed: int) -> tuple[int, int]:
    """The numbers that seed the random stream of a rollout that was reset with `seed`."""
    return seed, zlib.crc32(env_id.encode())


class RolloutRng(np.random.Generator):
    """The generator that policies get: each row of the batch has its own stream.

    The methods of `ROW_METHODS` with `size=B` or `size=(B, ...)` and scalar parameters take row i
    from rollout i's stream, so the numbers do not depend on which environments are stepped
    together. Any other call samples from one common stream.
    """

    def __init__(self, env_ids: Sequence[str], seeds: Sequence[int]) -> None:
        streams = list(map(rollout_stream, env_ids, seeds))
        super().__init__(np.random.PCG64([word for stream in streams for word in stream]))
        self._rows = [np.random.Generator(np.random.PCG64(stream)) for stream in streams]


def _by_rows(name: str) -> Callable[..., Any]:
    sample = getattr(np.random.Generator, name)
    signature = inspect.signature(sample)

    @functools.wraps(sample)
    def sample_rows(self: RolloutRng, *args: Any, **kwargs: Any) -> Any:
        given = signature.bind(self, *args, **kwargs).arguments
        given.pop("self")
        size = given.pop("size", None)
        shape = size if isinstance(size, tuple) else (size,)
        if shape[:1] != (len(self._rows),) or any(np.ndim(value) for value in given.values()):
            return sample(self, *args, **kwargs)
        return np.array([getattr(row, name)(size=shape[1:], **given) for row in self._rows])

    return sample_rows


ROW_METHODS = (
    *("random", "uniform", "integers", "gumbel"),
    *("normal", "standard_normal", "exponential", "standard_exponential"),
)
for _name in ROW_METHODS:
    setattr(RolloutRng, _name, _by_rows(_name))
