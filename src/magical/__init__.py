"""MAGICAL: the benchmark for robust imitation learning.

Importing registers the environments with Gymnasium and does nothing else:

    import gymnasium, magical
    env = gymnasium.make("magical/MoveToCorner-Demo-LoRes4E-v0")
"""

from magical.envs import all_env_ids, env_spec, parse_env_id, register_all, register_published
from magical.envs import register_envs as _register_envs
from magical.tasks import TASKS, Task, get_task
from magical.tasks import register_task as _register_task

__version__ = "1.0.0rc1"


def register_task(task: Task) -> None:
    """Register a task from outside the package, and its environments with Gymnasium."""
    _register_task(task)
    _register_envs(task.name)


register_all()

__all__ = [
    "TASKS",
    "Task",
    "__version__",
    "all_env_ids",
    "env_spec",
    "get_task",
    "parse_env_id",
    "register_published",
    "register_task",
]
