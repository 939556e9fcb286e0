"""Environment ids, `magical/<Task>-<Variant>[-<Preset>]-v0`, and their registration with Gymnasium.

No environment is imported here.
"""

import copy
from dataclasses import replace
from itertools import product
from typing import Any, Self

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from magical.errors import UnknownNameError
from magical.messages import quoted
from magical.observe import PRESETS
from magical.plugins import plugins
from magical.tasks import TASKS, Task, get_task, importable_tasks, possible_variants
from magical.tasks.registry import GROUP

NAMESPACE = "magical"
VERSION = "v0"
ENVIRONMENT = "magical.envs.env:MagicalEnv"
VECTOR_ENVIRONMENT = "magical.envs.vector:make_vector_env"
NO_TIME_LIMIT = WrapperSpec("NoTimeLimit", "magical.envs.env:refuse_time_limit", {})


class EnvId(str):
    """An environment id: a string with its parts as attributes.

    Being a string, it prints, compares and serialises like the id itself.

    Attributes:
        task: the task's name.
        variant: the variant's name, such as `Demo` or `TestJitter`.
        preset: the observation preset's name, or `None`.
    """

    __slots__ = ("preset", "task", "variant")

    task: str
    variant: str
    preset: str | None

    def __new__(cls, task: str, variant: str, preset: str | None = None) -> Self:
        """Join the parts; the names are not checked."""
        parts = (task, variant, *([preset] if preset else []), VERSION)
        self = super().__new__(cls, f"{NAMESPACE}/{'-'.join(parts)}")
        self.task, self.variant, self.preset = task, variant, preset
        return self

    def __reduce__(self) -> tuple[type["EnvId"], tuple[str, str, str | None]]:
        return EnvId, (self.task, self.variant, self.preset)

    @property
    def without_preset(self) -> "EnvId":
        """The id of the same task and variant without a preset."""
        return self if self.preset is None else EnvId(self.task, self.variant)

    @property
    def task_spec(self) -> Task:
        """The task itself; raises `UnknownNameError` if it is not registered."""
        return get_task(self.task)


def split_env_id(env_id: str) -> EnvId:
    """Split an id without checking its names (the leading `magical/` may be missing).

    Raises `UnknownNameError` for text in another format.
    """
    if isinstance(env_id, EnvId):
        return env_id
    task, *rest = str(env_id).removeprefix(f"{NAMESPACE}/").split("-")
    if not 2 <= len(rest) <= 3 or rest[-1] != VERSION:
        raise UnknownNameError(
            f"environment id {quoted(env_id)}: expected "
            f"{NAMESPACE}/<Task>-<Variant>[-<Preset>]-{VERSION}"
        )
    return EnvId(task, rest[0], rest[1] if len(rest) == 3 else None)


def parse_env_id(env_id: str) -> EnvId:
    """Split an id and check its names (the leading `magical/` may be missing).

    An `EnvId` is returned unchanged. Raises `UnknownNameError`, which names the unknown part and
    the alternatives.
    """
    if isinstance(env_id, EnvId):
        return env_id
    parsed = split_env_id(env_id)
    get_task(parsed.task).axes_of(parsed.variant)  # raises for a variant that the task lacks
    if parsed.preset is not None and parsed.preset not in PRESETS:
        raise UnknownNameError(
            f"environment id {quoted(env_id)}: preset {quoted(parsed.preset)} is unknown; "
            f"expected one of: {', '.join(PRESETS)}"
        )
    return parsed


def all_env_ids(presets: bool = False) -> list[EnvId]:
    """The ids of all variants of all importable tasks, except generated tasks.

    With `presets`, the ids with each preset as well.
    """
    return [
        EnvId(task.name, variant, preset)
        for task in importable_tasks()
        for variant in task.variants
        for preset in ((None, *PRESETS) if presets else (None,))
    ]


class RegisteredSpec(EnvSpec):
    """A specification with which `gymnasium.make` refuses `max_episode_steps`.

    Gymnasium tells entry points nothing of this argument, so what refuses it is registered as a
    wrapper, which is added after `TimeLimit`. `make_vec` tells its entry point, and allows no such
    wrappers: copies, which it makes, are without.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> EnvSpec:
        kwargs = copy.deepcopy(self.kwargs, memo)
        return replace(self, kwargs=kwargs, additional_wrappers=())


def register_envs(task: str) -> None:
    """Register a task's environments: each variant, without a preset and with each preset.

    For a task of another distribution that is not imported yet, all variants are registered; making
    an environment of a variant that the task lacks raises `UnknownNameError`.

    The environment truncates at its horizon and checks the order of calls itself, so Gymnasium's
    `TimeLimit` and `OrderEnforcing` wrappers are not used. An id that is taken stays as it is.
    """
    for variant, preset in product(possible_variants(task), (None, *PRESETS)):
        spec = _spec(EnvId(task, variant, preset))
        # `gymnasium.register` compares each id with all others, which takes long for hundreds.
        gym.registry.setdefault(spec.id, spec)


def env_spec(env_id: str) -> EnvSpec:
    """The specification of an environment, registered or not, for `gymnasium.make`.

    Raises `UnknownNameError`.
    """
    return _spec(parse_env_id(env_id))


def register_all() -> None:
    """Register the environments of `TASKS`; no other distribution is imported.

    Generated tasks are left out, since there are too many; `env_spec` has theirs.
    """
    for task in TASKS:
        register_envs(task)


def register_published() -> None:
    """Register the paper's environments under the ids of the published package as well.

    Those are without `magical/`, such as `MoveToCorner-Demo-LoRes4E-v0`.
    """
    published = [name for name in TASKS if name not in plugins(GROUP) and TASKS[name].section]
    for name, preset in product(published, (None, *PRESETS)):
        for variant in TASKS[name].variants:
            spec = _spec(EnvId(name, variant, preset))
            spec = replace(spec, id=spec.id.removeprefix(f"{NAMESPACE}/"))
            gym.registry.setdefault(spec.id, spec)


def _spec(env_id: EnvId) -> EnvSpec:
    kwargs = {"task": env_id.task, "variant": env_id.variant}
    if env_id.preset:
        kwargs["observation"] = env_id.preset
    return RegisteredSpec(
        id=str(env_id),
        entry_point=ENVIRONMENT,
        vector_entry_point=VECTOR_ENVIRONMENT,
        order_enforce=False,
        kwargs=kwargs,
        additional_wrappers=(NO_TIME_LIMIT,),
    )
