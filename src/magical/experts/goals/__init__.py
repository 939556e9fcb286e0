"""The goals of each task as moves of blocks and robot: one file per task, found by its name.

A task of this package in `magical/tasks/<file>.py` has its goals in `<file>.py` here, a module
that ends with `PLANNER = Planner(...)`. Other packages provide theirs by entry points in the group
`magical.experts`, named after the task (or by a pattern, a function from a task's name to its
planner), or call `register_planner`.
"""

import importlib
import re
from importlib.util import find_spec

from magical.errors import NoExpertError, PluginError
from magical.experts.planning import Planner
from magical.plugins import is_offered, load_plugin
from magical.tasks import TASKS

__all__ = ["get_planner", "has_expert", "register_planner"]

GROUP = "magical.experts"

_registered: dict[str, Planner] = {}


def register_planner(task: str, planner: Planner) -> None:
    """Register a task's planner, replacing any that it already has.

    Worker processes import the module of its plan function, which should make this call.

    Raises:
        PluginError: it is something else.
    """
    if not isinstance(planner, Planner):
        raise PluginError(f"{GROUP}: {task!r}: expected Planner, found {type(planner).__name__}")
    _registered[task] = planner


def get_planner(task: str) -> Planner:
    """The planner of a task's expert.

    Raises:
        NoExpertError: the task has no expert; the message says how to add one.
        PluginError: another package's planner cannot be imported, or is not a `Planner`.
    """
    if task in _registered:
        return _registered[task]
    planner: Planner
    if _is_ours(task):
        planner = importlib.import_module(f"{__name__}.{_file(task)}").PLANNER
    elif is_offered(GROUP, task):
        planner = load_plugin(GROUP, task)
    else:
        known = ", ".join(name for name in TASKS if has_expert(name))
        raise NoExpertError(
            f"{task!r} has no scripted expert; expected one of: {known}; add "
            f"magical/experts/goals/{_file(task)}.py, an entry point {task} of the group {GROUP}, "
            f"or call magical.experts.register_planner({task!r}, Planner(...))"
        )
    register_planner(task, planner)
    return planner


def has_expert(task: str) -> bool:
    """Whether a task has a scripted expert; another package's is not imported."""
    return task in _registered or _is_ours(task) or is_offered(GROUP, task)


def _is_ours(task: str) -> bool:
    return (
        task.isalnum() and task[0].isupper() and find_spec(f"{__name__}.{_file(task)}") is not None
    )


def _file(task: str) -> str:
    """The name of a task's file: `move_to_corner` for MoveToCorner."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", task).lower()
