"""Rollouts with fixed seeds: a policy, environments, scores."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId, parse_env_id
from magical.envs.episode import checked_nudge
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.envs.vector.workers import defining_modules
from magical.errors import UnknownNameError
from magical.evaluation.policy import Mask, Policy, checked_actions, is_privileged
from magical.evaluation.scores import RolloutScore
from magical.evaluation.seeds import RolloutRng
from magical.evaluation.variants import variants_of
from magical.observe import NAMED, PRESETS, Observation
from magical.processes import available_cores, map_in_processes
from magical.tasks import (
    TASKS,
    Horizon,
    Task,
    get_task,
    load_tasks,
    require_two_horizons,
)

ROLLOUTS = 100  # on each variant (appendix C)
NUM_ENVS = 64  # sub-environments stepped together: bounds the memory, hardly changes the speed
SHARE = 10  # rollouts of one environment that a process computes at a time
DEFAULT_OBSERVATION = "LoRes4E"

Progress = Callable[[int], None]  # called with the number of rollouts that have just ended


def environments(
    tasks: Iterable[str] | None = None, variants: Iterable[str] | None = None
) -> list[EnvId]:
    """Environment ids of the tasks' variants, by default all; short names are accepted.

    Raises `UnknownNameError` for unknown names, and for a task with none of the variants.
    """
    chosen = list(TASKS) if tasks is None else list(dict.fromkeys(tasks))
    wanted = None if variants is None else list(variants)
    return [
        EnvId(task.name, variant)
        for task in map(get_task, chosen)
        for variant in variants_of(task, wanted)
    ]


def evaluate(
    policy: Policy,
    env_ids: Sequence[str] | None = None,
    *,
    rollouts: int = ROLLOUTS,
    seed: int = 0,
    observation: Observation = None,
    horizon: Horizon = None,
    nudge: float = 0.0,
    num_envs: int = NUM_ENVS,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[RolloutScore]:
    """Score a policy on environments, all variants of a task together.

    Rollout i of every environment is reset with `evaluation_seed(i, seed)`. Scores depend neither
    on `workers` nor, for policies that sample row by row (`RolloutRng`), on `num_envs` or on what
    else is evaluated, but for the last bit of a network's arithmetic.

    Args:
        policy: see `Policy`; `load_policy` makes one from a name.
        env_ids: default: all variants of the policy's own tasks, or of all tasks; each counts once.
        rollouts: of each environment.
        seed: which set of fixed seeds; results are reported for 0.
        observation: by default the policy's own, or `LoRes4E`; states for a privileged policy.
        horizon: control steps; `"published"` takes the published code's, for comparison with
            published tables; for at least one of the tasks it must be another.
        nudge: shift each rollout's initial poses by up to so many units and radians, sampled from
            its seed; with 1e-9 Demo's score is no matter of rounding (docs/determinism.md).
        num_envs: the most environments to step together (at least one for each environment id).
        workers: processes; by default one for each core. They step the environments, and for a
            policy with `in_processes` they run the policy too.
        progress: called with the number of rollouts that have just ended.

    Returns:
        A score for each rollout, by environment in the given order, then by rollout.

    Raises:
        PolicyError: the policy returned something else than actions.
        UnknownNameError: an unknown environment, observation or horizon, or tasks with only one.
        ValueError: a nudge out of range, or less than one rollout.
    """
    default = environments(getattr(policy, "tasks", None)) if env_ids is None else env_ids
    ids = list(dict.fromkeys(parse_env_id(env_id).without_preset for env_id in default))
    _check_horizon(horizon, ids)
    if rollouts < 1:
        raise ValueError(f"rollouts: expected at least 1, found {rollouts}")
    setting = _Setting(policy, observation, horizon, checked_nudge(nudge), num_envs, seed)
    run = _in_processes if getattr(policy, "in_processes", False) else _in_this_process
    return _collect(run(setting, ids, rollouts, workers), ids, progress)


def evaluate_round(
    policy: Policy,
    env_ids: Sequence[EnvId],
    number: int,
    *,
    rollouts: int,
    seed: int = 0,
    observation: Observation = None,
    horizon: Horizon = None,
    nudge: float = 0.0,
    workers: int | None = None,
) -> list[RolloutScore]:
    """One round of an evaluation again: all rollouts that were run together with one of them.

    A network's arithmetic may depend on the size of the batch in the last bit, which can tip a
    sampled action. A round is a batch as `evaluate` makes it by default, so on the same machine its
    scores are the same.

    Args:
        policy: see `Policy`.
        env_ids: all environments of one task that the evaluation had, in its order.
        number: of the rollout.
        rollouts: of each environment in the evaluation.
        seed: as for `evaluate`, and so are
        observation: and
        horizon: and
        nudge: and
        workers: processes.
    """
    setting = _Setting(policy, observation, horizon, checked_nudge(nudge), NUM_ENVS, seed)
    if getattr(policy, "in_processes", False):
        first = number - number % SHARE
        numbers = range(first, min(first + SHARE, rollouts))
        return [row for env_id in env_ids for row in _score_share(setting, [], (env_id, numbers))]
    with _Rollouts(setting, env_ids[0].task_spec, env_ids, rollouts, workers) as batch:
        first = number - number % batch.copies
        numbers = range(first, min(first + batch.copies, rollouts))
        return [row for part in batch.run(numbers) for row in part]


def _collect(
    parts: Iterable[Sequence[RolloutScore]], ids: Sequence[EnvId], progress: Progress | None
) -> list[RolloutScore]:
    """All scores, by environment in the given order, then by rollout."""
    scores: dict[EnvId, list[RolloutScore]] = {env_id: [] for env_id in ids}
    for part in parts:
        for score in part:
            scores[score.env_id].append(score)
        if progress:
            progress(len(part))
    return [score for env_id in ids for score in scores[env_id]]


@dataclass(frozen=True, slots=True)
class _Setting:
    """What all rollouts of an evaluation have in common."""

    policy: Policy
    observation: Observation
    horizon: Horizon
    nudge: float
    num_envs: int
    seed: int


def _in_this_process(
    setting: _Setting, env_ids: Sequence[EnvId], rollouts: int, workers: int | None
) -> Iterator[list[RolloutScore]]:
    """The policy runs here, on all environments of a task at once; workers step them."""
    for task, group in _by_task(env_ids):
        with _Rollouts(setting, task, group, rollouts, workers) as batch:
            yield from batch.run(range(rollouts))


def _in_processes(
    setting: _Setting, env_ids: Sequence[EnvId], rollouts: int, workers: int | None
) -> Iterator[list[RolloutScore]]:
    """Copies of the policy run in several processes, each on a share of the rollouts."""
    shares = [
        (env_id, range(first, min(first + SHARE, rollouts)))
        for env_id in env_ids
        for first in range(0, rollouts, SHARE)
    ]
    count = min(available_cores() if workers is None else workers, len(shares))
    modules = _modules(setting.policy, env_ids) if count > 1 else []
    yield from map_in_processes(partial(_score_share, setting, modules), shares, count)


def _modules(policy: Policy, env_ids: Sequence[EnvId]) -> list[str]:
    """The modules from which a new process learns of the tasks, and what the policy needs."""
    tasks = {env_id.task: env_id.task_spec for env_id in env_ids}
    needed = getattr(policy, "modules", None)
    return [*defining_modules(list(tasks.values())), *(needed(list(tasks)) if needed else [])]


def _score_share(
    setting: _Setting, modules: Sequence[str], share: tuple[EnvId, range]
) -> list[RolloutScore]:
    for module in modules:
        load_tasks(module)
    env_id, numbers = share
    with _Rollouts(setting, env_id.task_spec, [env_id], len(numbers), workers=0) as batch:
        return [score for part in batch.run(numbers) for score in part]


class RepeatedEvaluation:
    """An evaluation that is repeated, as during training: its environments are kept alive.

    Args:
        policy: see `Policy`; not one that runs in processes of its own.
        env_ids: the environments.
        rollouts: of each environment.
        seed: as for `evaluate`, and so is
        horizon:
        workers: processes in all; each task has at least one, or with 0 none.
    """

    def __init__(
        self,
        policy: Policy,
        env_ids: Sequence[EnvId],
        *,
        rollouts: int,
        seed: int = 0,
        horizon: Horizon = None,
        workers: int | None = None,
    ) -> None:
        setting = _Setting(policy, None, horizon, 0.0, NUM_ENVS, seed)
        groups = list(_by_task(env_ids))
        total = available_cores() if workers is None else workers
        each = -(-total // len(groups))
        self._ids = list(env_ids)
        self._numbers = range(rollouts)
        with ExitStack() as stack:
            self._batches = [
                stack.enter_context(_Rollouts(setting, task, group, rollouts, each))
                for task, group in groups
            ]
            self._stack = stack.pop_all()

    def scores(self) -> list[RolloutScore]:
        """The score of each rollout, as `evaluate` returns them."""
        parts = (part for batch in self._batches for part in batch.run(self._numbers))
        return _collect(parts, self._ids, None)

    def close(self) -> None:
        """End the environments."""
        self._stack.close()


class _Rollouts:
    """Environments of one task, each with several copies, whose episodes run in step.

    Episodes end at the horizon and never before, so all begin and end together. Where the last
    round has fewer rollouts than copies, the remaining copies are inactive.
    """

    def __init__(
        self,
        setting: _Setting,
        task: Task,
        env_ids: Sequence[EnvId],
        rollouts: int,
        workers: int | None,
    ) -> None:
        rounds = -(-rollouts // max(1, setting.num_envs // len(env_ids)))
        self.copies = -(-rollouts // rounds)  # of each environment
        self.policy = setting.policy
        self.seed = setting.seed
        self.options = {"nudge": setting.nudge} if setting.nudge else None
        self.privileged = is_privileged(self.policy)
        self.env_ids = tuple(env_id for env_id in env_ids for _ in range(self.copies))
        self.horizon = task.resolve_horizon(setting.horizon)
        self.envs = MagicalVectorEnv(
            self.env_ids,
            workers=workers,
            observation=observation_for(self.policy, setting.observation),
            horizon=self.horizon,  # observations are copies: the policy may change them
        )

    def __enter__(self) -> "_Rollouts":
        return self

    def __exit__(self, *error: object) -> None:
        self.envs.close()

    def run(self, numbers: range) -> Iterator[list[RolloutScore]]:
        """The scores of the rollouts with these numbers in every environment, round by round."""
        for first in numbers[:: self.copies]:
            each = np.arange(first, first + self.copies)
            rollouts = np.tile(each, len(self.env_ids) // self.copies)
            active = rollouts < numbers.stop
            seeds = [evaluation_seed(number, self.seed) for number in rollouts.tolist()]
            scores, published = self._episodes(seeds, active)
            yield [
                RolloutScore(
                    self.env_ids[row],
                    int(rollouts[row]),
                    seeds[row],
                    float(scores[row]),
                    float(published[row]),
                )
                for row in np.flatnonzero(active).tolist()
            ]

    def _episodes(self, seeds: Sequence[int], active: Mask) -> tuple[NDArray[Any], NDArray[Any]]:
        """One episode in each active environment, and the final scores by both rules."""
        rng = RolloutRng(self.env_ids, seeds)
        observations, infos = self.envs.reset(seed=list(seeds), options=self.options)
        self.policy.reset(np.ones(len(seeds), np.bool_))
        for _ in range(self.horizon):
            given = self.envs.states() if self.privileged else observations
            actions = checked_actions(self.policy.act(given, self.env_ids, rng), len(seeds))
            observations, _, _, truncated, infos = self.envs.step(actions, active)
        assert truncated[active].all()
        return infos["eval_score"], infos["published_code_score"]


def observation_for(policy: Policy, observation: Observation = None) -> Observation:
    """The observation to make environments with: the one given, the policy's own, or `LoRes4E`.

    A privileged policy gets states; nothing is rendered for it.
    """
    if is_privileged(policy):
        return "state"
    own: Observation = getattr(policy, "observation", None) if observation is None else observation
    return DEFAULT_OBSERVATION if own is None else own


def observation_again(policy: Policy, recorded: str) -> Observation:
    """The observation for a policy whose evaluation was recorded, as `observation_for` takes it.

    The recorded name where the policy has no observation of its own, otherwise `None`.
    """
    own = getattr(policy, "observation", None)
    return recorded if own is None and recorded in (*PRESETS, *NAMED) else None


def _by_task(env_ids: Sequence[EnvId]) -> Iterator[tuple[Task, list[EnvId]]]:
    groups: dict[str, list[EnvId]] = {}
    for env_id in env_ids:
        groups.setdefault(env_id.task, []).append(env_id)
    for name, group in groups.items():
        yield get_task(name), group


def _check_horizon(horizon: Horizon, env_ids: Sequence[EnvId]) -> None:
    if horizon == "published":
        require_two_horizons(env_id.task for env_id in env_ids)
    elif horizon is not None and not (isinstance(horizon, int) and horizon > 0):
        raise UnknownNameError(
            f"horizon: expected a positive number of control steps, 'published' or None, "
            f"found {horizon!r}"
        )
