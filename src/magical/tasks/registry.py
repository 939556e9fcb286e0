"""All tasks by name: this package's, those of other distributions, and registered ones."""

import importlib
import pkgutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from types import ModuleType
from typing import Any, TypeVar

from magical.errors import InvalidTaskError, PluginError, UnknownNameError
from magical.plugins import (
    families,
    family_of,
    import_user_module,
    is_offered,
    load_family,
    load_plugin,
    plugins,
)
from magical.tasks.axes import VARIANTS
from magical.tasks.task import Task

Item = TypeVar("Item")
Result = TypeVar("Result")

GROUP = "magical.tasks"  # of entry points, each named like its task

_tasks: dict[str, Task] = {}
_imported_from: dict[str, str] = {}  # the module by whose import a task was registered


@dataclass(frozen=True, slots=True)
class TaskFamily:
    """Tasks that are made by their names, too many to list; an entry point named by a pattern.

    Attributes:
        make_fn: the task of a name that the pattern matches.
        suites: tasks to report together, by the suite's name.
    """

    make_fn: Callable[[str], Task]
    suites: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __call__(self, name: str) -> Task:
        """The task of this name."""
        return self.make_fn(name)


class _Tasks(Mapping[str, Task]):
    """Tasks by name: ours in the order of the appendix, then the others.

    Tasks of families can be looked up, but iteration leaves them out, since there are too many.
    Iteration imports no module of another distribution; looking up one of its tasks does.
    """

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*_tasks, *plugins(GROUP))))

    def __len__(self) -> int:
        return len({*_tasks, *plugins(GROUP)})

    def __contains__(self, name: object) -> bool:
        return name in _tasks or is_offered(GROUP, str(name))

    def __getitem__(self, name: str) -> Task:
        if name in _tasks or name not in self:
            return _tasks[name]
        task = _loaded(name)
        if task.name != name:
            raise PluginError(f"{GROUP}: expected the task {name!r}, found {task.name!r}")
        if name in plugins(GROUP):
            _tasks[name] = task
        return task


TASKS: Mapping[str, Task] = _Tasks()


def suites() -> dict[str, tuple[str, ...]]:
    """The suites of the installed families of tasks: names of tasks, by the suite's name."""
    found: dict[str, tuple[str, ...]] = {}
    for pattern in families(GROUP):
        if isinstance(family := load_family(GROUP, pattern), TaskFamily):
            found.update(family.suites)
    return found


def register_task(task: Task) -> Task:
    """Add a task to `TASKS` and return it.

    Raises:
        InvalidTaskError: another task already has this name.
    """
    if family_of(GROUP, task.name) or _tasks.get(task.name, task) is not task:
        raise InvalidTaskError(
            f"expected a new task name, found {task.name!r}, which is registered already; "
            "choose another"
        )
    _tasks[task.name] = task
    return task


def unregister_task(name: str) -> Task:
    """Remove a task from `TASKS` and return it.

    Raises:
        UnknownNameError: there is no such task, or it is of a family.
    """
    task = get_task(name)
    if _tasks.pop(task.name, None) is None:
        raise UnknownNameError(f"{task.name} is of a family of tasks, and cannot be removed")
    _imported_from.pop(task.name, None)
    return task


def get_task(name: str) -> Task:
    """The task with exactly this name.

    Raises:
        UnknownNameError: no task of this name is registered; the message lists the names.
        PluginError: a task of another distribution cannot be imported, or is something else.
    """
    if name in TASKS:
        return TASKS[name]
    close = get_close_matches(str(name), TASKS, n=1)
    hint = f"did you mean {close[0]!r}? Otherwise " if close else ""
    raise UnknownNameError(
        f"task {name!r} is not registered; expected one of: {', '.join(TASKS)}; {hint}"
        "import or install what registers it"
    )


def importable_tasks() -> list[Task]:
    """All tasks of `TASKS`, but those of other distributions that cannot be imported.

    A warning says which are left out.
    """
    tasks = []
    for name in TASKS:
        try:
            tasks.append(TASKS[name])
        except PluginError as error:
            warnings.warn(str(error), stacklevel=1)
    return tasks


def load_task(name: str) -> Task:
    """The task with a given name, or the one at `module:NAME`, which is imported and registered.

    Only for names that users give, never for those in entries, run folders and datasets, which may
    come from anywhere.

    Raises:
        UnknownNameError: no task of this name is registered.
        PluginError: the task cannot be found, or is something else.
        InvalidTaskError: another task already has the name of the imported one.
    """
    return register_task(_loaded(name)) if ":" in name else get_task(name)


def possible_variants(name: str) -> tuple[str, ...]:
    """The variants that a task has, or may have if it is not imported yet.

    Raises:
        UnknownNameError: there is no such task.
    """
    if name not in TASKS:
        get_task(name)  # raises
    return _tasks[name].variants if name in _tasks else tuple(VARIANTS)


def load_tasks(modules: Iterable[str]) -> None:
    """Import a user's modules in a new process and register the tasks that they hold."""
    for module in modules:
        register_tasks_of(import_user_module(module))


def register_tasks_of(module: ModuleType) -> None:
    """Register the tasks that a module holds, except those with names that are known already."""
    for task in vars(module).values():
        if isinstance(task, Task) and task.name not in TASKS:
            register_task(task)


def import_tasks(name: str) -> None:
    """Import a user's module, by its name or file, and register the tasks that it holds or makes.

    Raises:
        PluginError: it cannot be imported.
    """
    known = set(_tasks)
    module = import_user_module(name)
    register_tasks_of(module)
    _imported_from.update(dict.fromkeys(set(_tasks) - known, module.__name__))


def registering_module(task: str) -> str | None:
    """The module that registered a task when the user imported it, if there is one."""
    return _imported_from.get(task)


def with_tasks(work: Callable[[Item], Result], modules: Iterable[str]) -> Callable[[Item], Result]:
    """`work` to be called in another process, where the tasks of these modules are loaded first."""
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
        _tasks[task.name] = task  # without importing another distribution's task of this name


def _loaded(name: str) -> Task:
    task: Any = load_plugin(GROUP, name)
    if not isinstance(task, Task):
        raise PluginError(f"{GROUP}: {name!r}: expected a Task, found {type(task).__name__}")
    return task
