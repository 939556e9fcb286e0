"""Registration with Gymnasium, without importing any environment."""

import copy
import warnings
from dataclasses import replace
from itertools import product
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from magical.envs.ids import NAMESPACE, EnvId
from magical.observe.presets import PRESETS
from magical.plugins import plugins
from magical.tasks import TASKS, possible_variants
from magical.tasks.programs.suite import SUITE, task_name
from magical.tasks.registry import GROUP

ENVIRONMENT = "magical.envs.env:MagicalEnv"
VECTOR_ENVIRONMENT = "magical.envs.vector:make_vector_env"
PUBLISHED_ID = "magical.envs.registration:make_by_published_id"
NO_TIME_LIMIT = WrapperSpec("NoTimeLimit", "magical.envs.env:refuse_time_limit", {})


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
    `TimeLimit` and `OrderEnforcing` wrappers are not used.
    """
    for variant, preset in product(possible_variants(task), (None, *PRESETS)):
        _add(env_spec(EnvId(task, variant, preset)))


def env_spec(env_id: EnvId) -> EnvSpec:
    """The specification of an environment, whether or not it is registered."""
    kwargs = {"task": env_id.task, "variant": env_id.variant}
    if env_id.preset:
        kwargs["observation"] = env_id.preset
    return _spec(env_id, ENVIRONMENT, VECTOR_ENVIRONMENT, kwargs)


def register_all() -> None:
    """Register the environments of `TASKS` and of the suite; no other distribution is imported.

    Tasks of the appendix are also registered under the ids of the published package.
    """
    for task in (*TASKS, *map(task_name, SUITE)):
        register_envs(task)
    published = [name for name in TASKS if name not in plugins(GROUP) and TASKS[name].section]
    for name, preset in product(published, (None, *PRESETS)):
        for variant in TASKS[name].variants:
            env_id = EnvId(name, variant, preset)
            kwargs = {**gym.registry[env_id].kwargs, "new_id": str(env_id)}
            old_id = env_id.removeprefix(f"{NAMESPACE}/")
            _add(_spec(old_id, PUBLISHED_ID, PUBLISHED_ID, kwargs))


def _spec(
    env_id: str, entry_point: str, vector_entry_point: str, kwargs: dict[str, Any]
) -> EnvSpec:
    return RegisteredSpec(
        id=str(env_id),
        entry_point=entry_point,
        vector_entry_point=vector_entry_point,
        order_enforce=False,
        kwargs=kwargs,
        additional_wrappers=(NO_TIME_LIMIT,),
    )


def _add(spec: EnvSpec) -> None:
    """Add an environment unless its id is taken: entries name their task, so they stay valid.

    `gymnasium.register` compares each id with all others, which takes seconds for thousands.
    """
    gym.registry.setdefault(spec.id, spec)


def make_by_published_id(new_id: str, num_envs: int | None = None, **options: Any) -> Any:
    """The entry point of `gymnasium.make` and `make_vec` for ids of the published package."""
    from magical.envs.env import MagicalEnv
    from magical.envs.vector import make_vector_env

    old_id = new_id.removeprefix(f"{NAMESPACE}/")
    warnings.warn(f"{old_id} is now {new_id}", DeprecationWarning, stacklevel=3)
    if num_envs is None:
        return MagicalEnv(**options)
    return make_vector_env(num_envs=num_envs, **options)


# Gymnasium looks for render modes here; they are those of `MagicalEnv`.
make_by_published_id.metadata = {  # type: ignore[attr-defined]
    "render_modes": ["rgb_array"]
}
