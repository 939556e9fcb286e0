"""Registration with Gymnasium; it imports no environment."""

import gymnasium as gym

from magical.envs.ids import task_env_ids
from magical.tasks import TASKS, Task


def register_envs(task: Task) -> None:
    """Register a task's environments, each variant without and with every preset.

    The environment truncates at its horizon and checks the order of calls itself, so Gymnasium's
    `TimeLimit` and `OrderEnforcing` wrappers are not used.
    """
    for env_id in task_env_ids(task):
        gym.register(
            id=str(env_id),
            entry_point="magical.envs.env:MagicalEnv",
            vector_entry_point="magical.envs.vector:make_vector_env",
            order_enforce=False,
            kwargs={"task": task.name, "variant": env_id.variant}
            | ({"observation": env_id.preset} if env_id.preset else {}),
        )


def register_all() -> None:
    """Register the environments of every known task."""
    for task in TASKS.values():
        register_envs(task)
