"""How a policy is evaluated: one record, from which rollouts, entries, plans and clips are made."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import Any, Self

from gymnasium.utils import seeding

from magical.envs import EnvId, parse_env_id
from magical.envs.action_spec import DISCRETE
from magical.errors import InvalidConfigError, InvalidSceneError, PlacementError, UnknownNameError
from magical.grouping import group_by
from magical.observe import Observation, make_spec
from magical.scene import Dynamics, Pose, Scene
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
NUDGE = 1e-9  # evaluation noise of the leaderboard, in units and radians
# Units and radians. Two bodies may then still overlap as far as those of any sampled scene.
MAX_NOISE = 1e-4
MAX_SCENES = 1000  # shifted at most for one rollout


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """How a policy is evaluated (docs/protocol.md).

    Attributes:
        env_ids: the environments, without presets, each once.
        rollouts: the number of rollouts in each environment.
        seed: which set of fixed seeds.
        observation: what the policy is shown; `None` for its own or, if it has none, `LoRes4E`.
        horizon: control steps, or `None` for the appendix's; "published" for those of the published
            tables, which must differ for at least one of the tasks.
        nudge: evaluation noise, the largest shift of initial poses, in units and radians, sampled
            from each rollout's seed: `NUDGE` for the leaderboard, 0 for comparison with published
            scores. It averages over what rounding decides on Demo (docs/determinism.md).

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
        if not 0.0 <= self.nudge <= MAX_NOISE:
            raise InvalidConfigError(
                f"evaluation noise: expected a number from 0 to {MAX_NOISE}, found {self.nudge}"
            )

    @classmethod
    def of(cls, env_ids: Iterable[str], **settings: Any) -> Self:
        """An evaluation in environments given by ids of any form, or one; duplicates count once.

        Raises:
            UnknownNameError: an unknown environment or observation, or the published horizon for
                tasks that have only one horizon.
            InvalidConfigError, ValueError: as for the class; an id with a preset that is not the
                observation.
        """
        given = [env_ids] if isinstance(env_ids, str) else env_ids
        ids = list(map(parse_env_id, given))
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
    """How scores were obtained: the evaluation, and what it took from the policy.

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

    Variants may have their short names; a single task or variant may be given as a string. Raises
    `UnknownNameError` for unknown names, and for a task that is given and has none of the variants.
    """
    tasks = [tasks] if isinstance(tasks, str) else tasks
    variants = [variants] if isinstance(variants, str) else variants
    wanted = None if variants is None else set(map(full_variant, variants))
    env_ids: list[EnvId] = []
    for task in importable_tasks() if tasks is None else map(get_task, dict.fromkeys(tasks)):
        found = [name for name in task.variants if wanted is None or name in wanted]
        if not found and tasks is not None:
            asked = ", ".join(sorted(wanted or ()))
            known = ", ".join(map(short_variant, task.variants))
            raise UnknownNameError(f"{task.name} has none of the variants {asked}; it has: {known}")
        env_ids += [EnvId(task.name, variant) for variant in found]
    return env_ids


def noisy_start(env_id: EnvId, seed: int, noise: float) -> tuple[Scene, Dynamics]:
    """The scene and dynamics that an environment samples for a seed, with noise from this seed.

    Robot and blocks are shifted and turned by uniform samples up to `noise`. Raises
    `PlacementError` if none of `MAX_SCENES` such scenes fits the task.
    """
    task, (rng, _) = env_id.task_spec, seeding.np_random(seed)
    scene, dynamics = task.sample(env_id.variant, rng)

    def shift(pose: Pose) -> Pose:
        return Pose(*(pose + rng.uniform(-noise, noise, size=3)).tolist())

    for _ in range(MAX_SCENES):
        robot = shift(scene.robot)
        blocks = tuple(replace(block, pose=shift(block.pose)) for block in scene.blocks)
        noisy = replace(scene, robot=robot, blocks=blocks)
        with suppress(InvalidSceneError):
            task.validate(noisy)
            return noisy, dynamics
    raise PlacementError(f"{env_id}: none of {MAX_SCENES} scenes with noise {noise:g} fits")
