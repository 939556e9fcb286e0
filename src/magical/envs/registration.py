"""Registration with Gymnasium; it imports no environment."""

from contextlib import suppress
from itertools import product

import gymnasium as gym

from magical.envs.ids import EnvId
from magical.errors import PluginError
from magical.observe.presets import PRESETS
from magical.tasks import TASKS, possible_variants


def register_envs(task: str) -> None:
    """Register a task's environments by its name, each variant without and with every preset.

    Of a task of another distribution that is not imported yet, all variants are registered; an
    environment of one that it lacks raises `UnknownNameError` when it is made.

    The environment truncates at its horizon and checks the order of calls itself, so Gymnasium's
    `TimeLimit` and `OrderEnforcing` wrappers are not used.
    """
    for variant, preset in product(possible_variants(task), (None, *PRESETS)):
        if (env_id := str(EnvId(task, variant, preset))) in gym.registry:
            continue  # as long as it is a task of this name, it is the same environment
        gym.register(
            id=env_id,
            entry_point="magical.envs.env:MagicalEnv",
            vector_entry_point="magical.envs.vector:make_vector_env",
            order_enforce=False,
            kwargs={"task": task, "variant": variant} | ({"observation": preset} if preset else {}),
        )


def register_all() -> None:
    """Register the environments of every known task; no other distribution is imported."""
    with suppress(PluginError):  # two offer the same task: raised where one is asked for
        for task in TASKS:
            register_envs(task)
