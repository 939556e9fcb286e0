"""What each task asks for, as moves of blocks and robot: one file per task.

A task of this package in `magical/tasks/<file>.py` has its goals in `<file>.py` here, a module
that ends with `GOALS = Goals(...)`; nothing else names it. Files of other names are helpers.
Tasks from outside the package call `register_goals`.
"""

import importlib
import pkgutil
from functools import cache

import magical.tasks
from magical.errors import NoExpertError
from magical.experts.planning import Goals

__all__ = ["get_goals", "register_goals"]

_registered: dict[str, Goals] = {}


def register_goals(task: str, goals: Goals) -> None:
    """Give a task an expert.

    Args:
        task: The task's name. Goals that it already has are replaced.
        goals: The moves that it asks for.
    """
    _registered[task] = goals


def get_goals(task: str) -> Goals:
    """The goals of a task, registered or of this package.

    Raises:
        NoExpertError: there are none; says how to add them.
    """
    known = {**_packaged_goals(), **_registered}
    if task in known:
        return known[task]
    file = _task_files().get(task)
    remedy = f"add magical/experts/goals/{file}.py, or call" if file else "call"
    raise NoExpertError(
        f"{task!r} has no scripted expert; expected one of: {', '.join(sorted(known))}; "
        f"{remedy} magical.experts.register_goals({task!r}, Goals(...))"
    )


@cache
def _packaged_goals() -> dict[str, Goals]:
    """The `GOALS` of the modules here, by the tasks whose files have the same names."""
    files = {module.name for module in pkgutil.iter_modules(__path__)}
    return {
        task: importlib.import_module(f"{__name__}.{file}").GOALS
        for task, file in _task_files().items()
        if file in files
    }


@cache
def _task_files() -> dict[str, str]:
    """The module name of every task of the package `magical.tasks`."""
    package = magical.tasks
    names = [module.name for module in pkgutil.iter_modules(package.__path__)]
    modules = {name: importlib.import_module(f"{package.__name__}.{name}") for name in names}
    return {module.TASK.name: name for name, module in modules.items() if hasattr(module, "TASK")}
