"""MAGICAL: the benchmark for robust imitation learning.

Importing registers the environments with Gymnasium and does nothing else:

    import gymnasium, magical
    env = gymnasium.make("magical/MoveToCorner-Demo-LoRes4E-v0")
"""

import warnings

from magical.envs import all_env_ids, parse_env_id, register_all
from magical.envs import register_envs as _register_envs
from magical.tasks import TASKS, Task, get_task
from magical.tasks import register_task as _register_task

__version__ = "1.0.0rc1"


def register_task(task: Task) -> None:
    """Register a task from outside the package, and its environments with Gymnasium."""
    _register_task(task)
    _register_envs(task.name)


def register_envs() -> None:
    """Do nothing: importing the package registers its environments."""
    warnings.warn(
        "magical.register_envs() does nothing: importing magical registers the environments",
        DeprecationWarning,
        stacklevel=2,
    )


register_all()

__all__ = [
    "TASKS",
    "Task",
    "__version__",
    "all_env_ids",
    "get_task",
    "parse_env_id",
    "register_task",
]
