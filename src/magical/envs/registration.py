"""Registration with Gymnasium, without importing any environment."""

import copy
from dataclasses import replace
from itertools import product
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from magical.envs.ids import NAMESPACE, EnvId, parse_env_id
from magical.observe.presets import PRESETS
from magical.plugins import plugins
from magical.tasks import TASKS, possible_variants
from magical.tasks.registry import GROUP

ENVIRONMENT = "magical.envs.env:MagicalEnv"
VECTOR_ENVIRONMENT = "magical.envs.vector:make_vector_env"
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
        _add(_spec(EnvId(task, variant, preset)))


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
            _add(replace(spec, id=spec.id.removeprefix(f"{NAMESPACE}/")))


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


def _add(spec: EnvSpec) -> None:
    """Add an environment unless its id is taken: entries name their task, so they stay valid.

    `gymnasium.register` compares each id with all others, which takes long for hundreds.
    """
    gym.registry.setdefault(spec.id, spec)
