"""Every task by name: those of this package, and those registered from outside."""

import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from types import MappingProxyType

from magical.errors import InvalidTaskError, UnknownNameError
from magical.tasks.task import Task

_tasks: dict[str, Task] = {}
TASKS: Mapping[str, Task] = MappingProxyType(_tasks)  # in the order of the appendix


def register_task(task: Task) -> Task:
    """Add a task to `TASKS` and return it.

    Raises:
        InvalidTaskError: another task has its name.
    """
    if _tasks.get(task.name, task) is not task:
        raise InvalidTaskError(
            f"expected a new task name, found {task.name!r}, which is registered already; "
            "choose another"
        )
    _tasks[task.name] = task
    return task


def unregister_task(name: str) -> Task:
    """Remove a task from `TASKS` and return it.

    Raises:
        UnknownNameError: no such task.
    """
    task = get_task(name)
    del _tasks[name]
    return task


def get_task(name: str) -> Task:
    """The task of that exact name.

    Raises:
        UnknownNameError: no such task; the message lists the names.
    """
    if name in _tasks:
        return _tasks[name]
    close = get_close_matches(str(name), _tasks, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise UnknownNameError(f"{name!r} is no task; expected one of: {', '.join(_tasks)}{hint}")


def load_tasks(module: str) -> None:
    """Import a module by name and register the tasks that it holds, if it has not done so."""
    for task in vars(importlib.import_module(module)).values():
        if isinstance(task, Task) and task.name not in _tasks:
            register_task(task)


def discover(package: str, path: Iterable[str]) -> None:
    """Register the `TASK` of every module in a package, in the order of the appendix's sections."""
    names = [f"{package}.{module.name}" for module in pkgutil.iter_modules(path)]
    modules = [importlib.import_module(name) for name in names]
    tasks = [module.TASK for module in modules if hasattr(module, "TASK")]
    for task in sorted(tasks, key=lambda task: (not task.section, task.section, task.name)):
        register_task(task)
