"""Every task by name: those of this package, of other distributions, and registered ones."""

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from difflib import get_close_matches
from functools import partial
from typing import Any, TypeVar

from magical.errors import InvalidTaskError, PluginError, UnknownNameError
from magical.plugins import load_plugin, plugins
from magical.tasks.axes import VARIANTS
from magical.tasks.programs.generated import generated_task, is_generated
from magical.tasks.task import Task

Item = TypeVar("Item")
Result = TypeVar("Result")

GROUP = "magical.tasks"  # of entry points, named like their tasks

_tasks: dict[str, Task] = {}


class _Tasks(Mapping[str, Task]):
    """Tasks by name: ours in the order of the appendix, then the others.

    Generated tasks are in it, but there are too many to iterate over. Iteration imports no module
    of another distribution; taking a task from here does.
    """

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*_tasks, *plugins(GROUP))))

    def __len__(self) -> int:
        return len({*_tasks, *plugins(GROUP)})

    def __contains__(self, name: object) -> bool:
        return name in _tasks or name in plugins(GROUP) or is_generated(str(name))

    def __getitem__(self, name: str) -> Task:
        if is_generated(name):
            return generated_task(name)
        if name not in _tasks and name in plugins(GROUP):
            task = _loaded(name)
            if task.name != name:
                raise PluginError(f"{GROUP}: expected the task {name!r}, found {task.name!r}")
            _tasks[name] = task
        return _tasks[name]


TASKS: Mapping[str, Task] = _Tasks()


def register_task(task: Task) -> Task:
    """Add a task to `TASKS` and return it.

    Raises:
        InvalidTaskError: another task has its name.
    """
    if TASKS.get(task.name, task) is not task:
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
    if _tasks.pop(task.name, None) is None:
        raise UnknownNameError(f"{task.name} is a generated task, which cannot be removed")
    return task


def get_task(name: str) -> Task:
    """The task of that exact name.

    Raises:
        UnknownNameError: no task of this name is registered; the message lists the names.
        PluginError: the task of another distribution cannot be imported.
    """
    if name in TASKS:
        return TASKS[name]
    close = get_close_matches(str(name), TASKS, n=1)
    hint = f"did you mean {close[0]!r}?" if close else "import or install what registers it"
    raise UnknownNameError(
        f"task {name!r} is not registered; expected one of: {', '.join(TASKS)}; {hint}"
    )


def load_task(name: str) -> Task:
    """The task of a name, or of `module:NAME`, which is imported and registered.

    Only for names that users give, never for those in entries, run folders and datasets, which may
    come from anywhere.

    Raises:
        UnknownNameError: no task of this name is registered.
        PluginError: the task cannot be imported.
    """
    return register_task(_loaded(name)) if ":" in name else get_task(name)


def possible_variants(name: str) -> tuple[str, ...]:
    """The variants that a registered task has, or may have where it is not imported yet."""
    return _tasks[name].variants if name in _tasks else tuple(VARIANTS)


def load_tasks(modules: Iterable[str]) -> None:
    """Import modules by name and register the tasks that they hold, if they have not done so."""
    for module in modules:
        for task in vars(importlib.import_module(module)).values():
            if isinstance(task, Task) and task.name not in _tasks:
                register_task(task)


def with_tasks(work: Callable[[Item], Result], modules: Iterable[str]) -> Callable[[Item], Result]:
    """`work` for another process, which loads the tasks of these modules before it is called."""
    return partial(_with_tasks, work, tuple(modules))


def _with_tasks(work: Callable[[Item], Result], modules: Iterable[str], item: Item) -> Result:
    load_tasks(modules)
    return work(item)


def discover(package: str, path: Iterable[str]) -> None:
    """Register the `TASK` of every module in a package, in the order of the appendix's sections."""
    names = [f"{package}.{module.name}" for module in pkgutil.iter_modules(path)]
    modules = [importlib.import_module(name) for name in names]
    tasks = [module.TASK for module in modules if hasattr(module, "TASK")]
    for task in sorted(tasks, key=lambda task: (not task.section, task.section, task.name)):
        _tasks[task.name] = task  # imports no task of this name of another distribution


def _loaded(name: str) -> Task:
    task: Any = load_plugin(GROUP, name)
    if not isinstance(task, Task):
        raise PluginError(f"{GROUP}: {name!r}: expected a Task, found {type(task).__name__}")
    return task
