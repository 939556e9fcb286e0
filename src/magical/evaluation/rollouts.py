"""Rollouts with fixed seeds: a policy, environments, scores; and a sample of them run again.

Running an entry's rollouts again finds mistakes. A policy that was made to deceive, such as one
that knows the public seeds' scenes, does again what it did before.
"""

import functools
import inspect
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidActionError, PolicyError, ScoresError
from magical.evaluation.entry import Entry, Record, RolloutScore
from magical.evaluation.policy import (
    NO_OBSERVATION,
    Mask,
    Policy,
    action_spec_of,
    is_privileged,
    load_policy,
    observation_for,
    observed,
)
from magical.evaluation.protocol import ROLLOUTS, SEED, Evaluation, environments, noisy_start
from magical.evaluation.statistics import CONFIDENCE, Interval, t_interval
from magical.grouping import group_by
from magical.observe import Observation
from magical.processes import checked_workers, map_in_processes
from magical.tasks import Horizon, get_task, with_tasks
from magical.tasks.registry import defining_modules

NUM_ENVS = 64  # sub-environments stepped together: bounds the memory, hardly changes the speed
SHARE = 10  # rollouts of one environment that a process computes at a time
TOLERANCE = 1e-9  # the largest difference between equal scores

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
    options = None
    if nudge:
        starts = zip(*map(noisy_start, envs.env_ids, seeds, repeat(nudge)), strict=True)
        options = dict(zip(("scene", "dynamics"), map(list, starts), strict=True))
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

    Of each task so many rounds (`_rounds`) are run again, chosen by `rng`; `elsewhere` says
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
            # In batches as before: their size may change the last bit of a network's arithmetic.
            batches = _batches(policy, replace(evaluation, env_ids=tuple(env_ids)))
            left = set(range(evaluation.rollouts))
            for _ in range(rounds):
                if not left:
                    break
                number = int(rng.choice(sorted(left)))
                for batch in batches:
                    if number in batch[1]:
                        for scores in _rounds(policy, evaluation, batch, workers, number):
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
