"""How a policy is evaluated: one record, from which rollouts, entries, plans and clips are made."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Self

from magical.envs import EnvId, parse_env_id
from magical.envs.action_spec import DISCRETE
from magical.errors import UnknownNameError
from magical.evaluation.noise import checked_noise
from magical.grouping import group_by
from magical.observe import Observation, make_spec
from magical.tasks import (
    Horizon,
    format_horizon,
    get_task,
    importable_tasks,
    parse_horizon,
    require_two_horizons,
)
from magical.tasks.axes import full_variant, short_variant

ROLLOUTS = 100  # on each variant (appendix C)
SEED = 0  # the set of fixed seeds that results are reported for
NUDGE = 1e-9  # the leaderboard's, in units and radians


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """How a policy is evaluated (docs/protocol.md).

    Attributes:
        env_ids: the environments, without presets, each once.
        rollouts: the number of rollouts in each environment.
        seed: which set of fixed seeds.
        observation: what the policy is shown; `None` for its own or, if it has none, `LoRes4E`.
        horizon: control steps, "published", or `None` for the appendix's.
        nudge: the largest shift of initial poses, in units and radians: `NUDGE` for the
            leaderboard, 0 for comparison with published scores.

    Raises:
        InvalidConfigError: an invalid horizon or nudge.
        ValueError: no environment, a negative seed, or fewer than one rollout.
    """

    env_ids: tuple[EnvId, ...]
    rollouts: int = ROLLOUTS
    seed: int = SEED
    observation: Observation = None
    horizon: Horizon = None
    nudge: float = 0.0

    def __post_init__(self) -> None:
        if not self.env_ids:
            raise ValueError("env_ids: expected at least one environment, found none")
        if self.rollouts < 1:
            raise ValueError(f"rollouts: expected at least 1, found {self.rollouts}")
        if self.seed < 0:  # below 0 are the seeds of demonstrations and of training
            raise ValueError(f"seed: expected at least 0, found {self.seed}")
        object.__setattr__(self, "horizon", parse_horizon(self.horizon))
        object.__setattr__(self, "nudge", checked_noise(self.nudge))

    @classmethod
    def of(cls, env_ids: Iterable[str], **settings: Any) -> Self:
        """An evaluation in environments given by ids of any form; duplicates count once.

        A single id may be given as a string.

        Raises:
            UnknownNameError: an unknown environment or observation, or the published horizon for
                tasks that have only one horizon.
            InvalidConfigError, ValueError: as for the class; an id with a preset that is not the
                observation.
        """
        given = [env_ids] if isinstance(env_ids, str) else env_ids
        ids = dict.fromkeys(map(parse_env_id, given))
        observation = settings.get("observation")
        for env_id in ids:
            if env_id.preset not in (None, observation):
                raise ValueError(
                    f"{env_id}: expected an environment id without a preset; the observation is "
                    f"set by observation={env_id.preset!r}, or by the policy"
                )
        evaluation = cls(env_ids=tuple(dict.fromkeys(i.without_preset for i in ids)), **settings)
        if observation is not None:
            make_spec(observation, evaluation.env_ids[0].task_spec)
        if evaluation.horizon == "published":
            require_two_horizons(env_id.task for env_id in ids)
        return evaluation

    @property
    def horizon_name(self) -> str:
        """The horizon as text; `appendix` if every task has the appendix's number of steps."""
        tasks = [env_id.task_spec for env_id in self.env_ids]
        same = all(task.resolve_horizon(self.horizon) == task.horizon for task in tasks)
        return format_horizon(None if same else self.horizon)

    @property
    def settings(self) -> dict[str, Any]:
        """Everything but the environments, by name."""
        names = (field.name for field in fields(self) if field.name != "env_ids")
        return {name: getattr(self, name) for name in names}

    @property
    def by_task(self) -> dict[str, list[EnvId]]:
        """The environments of each task, both in the given order."""
        return group_by(self.env_ids, attrgetter("task"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluated(Evaluation):
    """How scores were obtained: the evaluation, with the policy's observation and action space.

    Two scores in an environment are averaged only if this is equal, apart from other environments.

    Attributes:
        action_space: the name of the policy's action space.
        privileged: whether the policy was shown the true state.
    """

    action_space: str = DISCRETE.name
    privileged: bool = False


def environments(
    tasks: Iterable[str] | None = None, variants: Iterable[str] | None = None
) -> list[EnvId]:
    """Environment ids of the tasks' variants, by default of all importable tasks.

    Short names of variants are accepted.

    A single task or variant may be given as a string.

    Raises `UnknownNameError` for unknown names, and for a task that is given and has none of the
    variants.
    """
    tasks = [tasks] if isinstance(tasks, str) else tasks
    variants = [variants] if isinstance(variants, str) else variants
    wanted = None if variants is None else set(map(full_variant, variants))
    env_ids: list[EnvId] = []
    for task in importable_tasks() if tasks is None else map(get_task, dict.fromkeys(tasks)):
        found = [name for name in task.variants if wanted is None or name in wanted]
        if not found and tasks is not None:
            known = ", ".join(map(short_variant, task.variants))
            raise UnknownNameError(
                f"{task.name} has none of the variants {', '.join(sorted(wanted or ()))}; it has: "
                f"{known}"
            )
        env_ids += [EnvId(task.name, variant) for variant in found]
    return env_ids
