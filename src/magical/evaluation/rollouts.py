"""Rollouts with fixed seeds: a policy, environments, scores."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId, parse_env_id
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.errors import UnknownNameError
from magical.evaluation.policy import Mask, Policy, checked_actions, is_privileged
from magical.evaluation.scores import RolloutScore
from magical.evaluation.seeds import RolloutRng
from magical.evaluation.variants import variants_of
from magical.observe import Observation
from magical.tasks import TASKS, Task, get_task

ROLLOUTS = 100  # on each variant (appendix C)
NUM_ENVS = 64  # worlds side by side: bounds the memory, hardly changes the speed
DEFAULT_OBSERVATION = "LoRes4E"

Horizon = int | Literal["published"] | None
Progress = Callable[[int], None]  # is told how many rollouts have just ended


def environments(
    tasks: Iterable[str] | None = None, variants: Iterable[str] | None = None
) -> list[EnvId]:
    """Environment ids of the tasks' variants, by default all; short names are accepted.

    Raises `UnknownNameError` for unknown names, and for a task with none of the variants.
    """
    chosen = list(TASKS) if tasks is None else list(dict.fromkeys(tasks))
    wanted = None if variants is None else list(variants)
    return [
        EnvId(name, variant) for name in chosen for variant in variants_of(get_task(name), wanted)
    ]


def evaluate(
    policy: Policy,
    env_ids: Sequence[str] | None = None,
    *,
    rollouts: int = ROLLOUTS,
    seed: int = 0,
    observation: Observation = None,
    horizon: Horizon = None,
    num_envs: int = NUM_ENVS,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[RolloutScore]:
    """Score a policy on environments, all variants of a task in one sweep.

    Rollout i of every environment is reset with `evaluation_seed(i, seed)`, so every policy gets
    the same scenes. Scores depend neither on `workers` nor, for policies that draw their random
    numbers row by row (`RolloutRng`), on `num_envs` or on what else is evaluated; a network's
    arithmetic may still differ in the last bit between batch sizes.

    Args:
        policy: see `Policy`; `load_policy` makes one from a name.
        env_ids: by default all variants of the policy's own tasks, or of all tasks.
        rollouts: of each environment.
        seed: which set of fixed seeds; results are reported for 0.
        observation: by default the policy's own, or `LoRes4E`; states for a privileged policy.
        horizon: control steps; `"published"` takes the published code's, for comparison with
            published tables.
        num_envs: the most worlds to step side by side (at least one for each environment).
        workers: processes, as for `MagicalVectorEnv`.
        progress: called with the number of rollouts that have just ended.

    Returns:
        A score for each rollout, by environment in the given order, then by rollout.

    Raises:
        PolicyError: the policy returned something else than actions.
        UnknownNameError: an unknown environment, observation or horizon.
    """
    ids = environments(getattr(policy, "tasks", None))
    if env_ids is not None:
        ids = [parse_env_id(env_id).without_preset for env_id in env_ids]
    if rollouts < 1:
        raise ValueError(f"rollouts: expected at least 1, found {rollouts}")
    scores: dict[EnvId, list[RolloutScore]] = {env_id: [] for env_id in ids}
    for task, group in _by_task(ids):
        with _Sweep(
            policy, task, group, rollouts, num_envs, observation, horizon, workers
        ) as sweep:
            for score in sweep.run(rollouts, seed, progress):
                scores[score.env_id].append(score)
    return [score for env_id in ids for score in scores[env_id]]


class _Sweep:
    """All of one task's environments side by side, episodes in step with each other.

    Episodes end at the horizon and never before, so that all worlds begin and end together. Where
    the last wave has fewer rollouts than worlds, the worlds over rest.
    """

    def __init__(
        self,
        policy: Policy,
        task: Task,
        env_ids: Sequence[EnvId],
        rollouts: int,
        num_envs: int,
        observation: Observation,
        horizon: Horizon,
        workers: int | None,
    ) -> None:
        waves = -(-rollouts // max(1, num_envs // len(env_ids)))
        self.repeats = -(-rollouts // waves)  # worlds for each environment
        self.policy = policy
        self.privileged = is_privileged(policy)
        self.env_ids = tuple(env_id for env_id in env_ids for _ in range(self.repeats))
        self.horizon = _resolve_horizon(horizon, task)
        self.envs = MagicalVectorEnv(
            self.env_ids,
            workers=workers,
            observation=shown_to(policy, observation),
            horizon=self.horizon,
            copy=False,
        )

    def __enter__(self) -> "_Sweep":
        return self

    def __exit__(self, *error: object) -> None:
        self.envs.close()

    def run(self, rollouts: int, seed: int, progress: Progress | None) -> Iterator[RolloutScore]:
        """Every rollout's score, a wave at a time."""
        for first in range(0, rollouts, self.repeats):
            wave = np.arange(first, first + self.repeats)
            numbers = np.tile(wave, len(self.env_ids) // self.repeats)
            counted = numbers < rollouts
            seeds = [evaluation_seed(int(number), seed) for number in numbers]
            scores, published = self._episodes(seeds, counted)
            for row in np.flatnonzero(counted):
                yield RolloutScore(
                    self.env_ids[row],
                    int(numbers[row]),
                    seeds[row],
                    float(scores[row]),
                    float(published[row]),
                )
            if progress:
                progress(int(counted.sum()))

    def _episodes(self, seeds: Sequence[int], active: Mask) -> tuple[NDArray[Any], NDArray[Any]]:
        """One episode in each active world, and the final scores by both rules."""
        rng = RolloutRng(self.env_ids, seeds)
        observations, infos = self.envs.reset(seed=list(seeds))
        self.policy.reset(np.ones(len(seeds), np.bool_))
        for _ in range(self.horizon):
            shown = self.envs.states() if self.privileged else observations
            actions = checked_actions(self.policy.act(shown, self.env_ids, rng), len(seeds))
            observations, _, _, truncated, infos = self.envs.step(actions, active)
        assert truncated[active].all()
        return infos["eval_score"], infos["published_code_score"]


def shown_to(policy: Policy, observation: Observation = None) -> Observation:
    """What a policy is shown: what is asked for, else its own, else `LoRes4E`.

    A privileged policy gets states; the environments then draw nothing.
    """
    if is_privileged(policy):
        return "state"
    own: Observation = getattr(policy, "observation", None) if observation is None else observation
    return DEFAULT_OBSERVATION if own is None else own


def _by_task(env_ids: Sequence[EnvId]) -> Iterator[tuple[Task, list[EnvId]]]:
    groups: dict[str, list[EnvId]] = {}
    for env_id in env_ids:
        groups.setdefault(env_id.task, []).append(env_id)
    for name, group in groups.items():
        yield get_task(name), group


def _resolve_horizon(horizon: Horizon, task: Task) -> int:
    if horizon is None:
        return task.horizon
    if horizon == "published":
        return task.published_horizon
    if isinstance(horizon, int) and horizon > 0:
        return horizon
    raise UnknownNameError(
        f"horizon: expected a positive number of control steps, 'published' or None, "
        f"found {horizon!r}"
    )
