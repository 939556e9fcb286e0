"""All tasks by name: this package's, those of other distributions, and registered ones."""

import importlib
import pkgutil
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from typing import Any, TypeVar

from magical.errors import InvalidTaskError, PluginError, UnknownNameError
from magical.plugins import (
    families,
    family_of,
    import_user_module,
    is_offered,
    load_plugin,
    plugins,
)
from magical.tasks.axes import VARIANTS
from magical.tasks.task import Task

Item = TypeVar("Item")
Result = TypeVar("Result")

GROUP = "magical.tasks"  # of entry points, each named like its task

_tasks: dict[str, Task] = {}
_own: set[str] = set()  # the names of this package's
_imported_from: dict[str, str] = {}  # the module by whose import a task was registered


@dataclass(frozen=True, slots=True)
class TaskFamily:
    """Tasks that are made by their names, too many to list; an entry point named by a pattern."""

    make_fn: Callable[[str], Task]  # the task of a name that the pattern matches
    suites: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # tasks to report together

    def __call__(self, name: str) -> Task:
        """The task of this name."""
        return self.make_fn(name)


class _Tasks(Mapping[str, Task]):
    """Tasks by name: ours in the order of the appendix, then the others.

    Iteration leaves out families, whose tasks are too many, and imports no other distribution.
    """

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*_tasks, *plugins(GROUP))))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __contains__(self, name: object) -> bool:
        return name in _tasks or is_offered(GROUP, str(name))

    def __getitem__(self, name: str) -> Task:
        if name in _tasks or name not in self:
            return _tasks[name]
        task = _load(name)
        if task.name != name:
            raise PluginError(f"{GROUP}: expected the task {name!r}, found {task.name!r}")
        if name in plugins(GROUP):
            task.validate(task.demo)
            _tasks[name] = task
        return task


TASKS: Mapping[str, Task] = _Tasks()


def suites() -> dict[str, tuple[str, ...]]:
    """The suites of the installed families of tasks: names of tasks, by the suite's name."""
    found: dict[str, tuple[str, ...]] = {}
    for pattern in families(GROUP):
        if isinstance(family := load_plugin(GROUP, pattern), TaskFamily):
            found.update(family.suites)
    return found


def register_task(task: Task) -> Task:
    """Add a task to `TASKS` and return it.

    Raises `InvalidTaskError` for a name that another task has, and `InvalidSceneError` for a Demo
    scene that cannot be simulated.
    """
    if family_of(GROUP, task.name) or _tasks.get(task.name, task) is not task:
        raise InvalidTaskError(
            f"expected a new task name, found {task.name!r}, which is registered already"
        )
    task.validate(task.demo)
    _tasks[task.name] = task
    return task


def unregister_task(name: str) -> Task:
    """Remove a registered task from `TASKS` and return it; raises `UnknownNameError`."""
    task = get_task(name)
    if _tasks.pop(name, None) is None:
        raise UnknownNameError(f"{name} is of a family of tasks, and cannot be removed")
    _imported_from.pop(name, None)
    return task


def get_task(name: str) -> Task:
    """The task with exactly this name; raises `UnknownNameError` or `PluginError`."""
    if name in TASKS:
        return TASKS[name]
    close = get_close_matches(str(name), TASKS, n=1)
    hint = f"did you mean {close[0]!r}? Otherwise " if close else ""
    raise UnknownNameError(
        f"task {name!r} is not registered; expected one of: {', '.join(TASKS)}; {hint}"
        "import or install what registers it"
    )


def importable_tasks() -> list[Task]:
    """All tasks of `TASKS`; a warning says which of other distributions cannot be imported."""
    tasks = []
    for name in TASKS:
        try:
            tasks.append(TASKS[name])
        except PluginError as error:
            warnings.warn(str(error), stacklevel=1)
    return tasks


def load_task(name: str) -> Task:
    """The task with a given name, or the one at `module:NAME`, which is imported and registered.

    Only for names that users give: those in files may come from anywhere.
    """
    return register_task(_load(name)) if ":" in name else get_task(name)


def possible_variants(name: str) -> tuple[str, ...]:
    """The variants that a task has, or may have if it is not imported yet."""
    if name in _tasks or name not in TASKS:
        return get_task(name).variants
    return tuple(VARIANTS)


def import_tasks(name: str) -> None:
    """Import a user's module, and register the tasks that it holds; raises `PluginError`."""
    known, module = set(_tasks), import_user_module(name)
    for task in list(vars(module).values()):
        if isinstance(task, Task) and task.name not in TASKS:
            register_task(task)
    _imported_from.update(dict.fromkeys(set(_tasks) - known, module.__name__))


def load_tasks(modules: Iterable[str]) -> None:
    """As `import_tasks`, for several modules."""
    for name in modules:
        import_tasks(name)


def defining_modules(tasks: Iterable[Task]) -> list[str]:
    """The modules that a new process must import to have tasks, but for those of entry points.

    Raises `InvalidTaskError` for a task that no importable module holds.
    """
    others = [task for task in tasks if task.name not in _own and not is_offered(GROUP, task.name)]
    return sorted(set(map(_defining_module, others)))


def _defining_module(task: Task) -> str:
    for name, module in list(sys.modules.items()):
        held = list(getattr(module, "__dict__", {}).values())
        if name not in ("__main__", "__mp_main__") and any(value is task for value in held):
            return name
    if task.name in _imported_from:
        return _imported_from[task.name]
    raise InvalidTaskError(
        f"task {task.name}: other processes never import the main script, and no importable module "
        "holds this task; give it a name in a module, or use workers=1"
    )


def with_tasks(work: Callable[[Item], Result], modules: Iterable[str]) -> Callable[[Item], Result]:
    """The function, for another process: it first imports the tasks that modules hold."""
    return partial(_with_tasks, work, tuple(modules))


def _with_tasks(work: Callable[[Item], Result], modules: Iterable[str], item: Item) -> Result:
    load_tasks(modules)
    return work(item)


def discover(package: str, path: Iterable[str]) -> None:
    """Register the tasks in the modules of a package, in the order of the appendix's sections."""
    modules = [importlib.import_module(f"{package}.{m.name}") for m in pkgutil.iter_modules(path)]
    tasks = [task for module in modules for task in vars(module).values() if isinstance(task, Task)]
    for task in sorted(tasks, key=lambda task: (not task.section, task.section, task.name)):
        _own.add(task.name)
        _tasks[task.name] = task  # without importing another distribution's task of this name


def _load(name: str) -> Task:
    task: Any = load_plugin(GROUP, name)
    if not isinstance(task, Task):
        raise PluginError(f"{GROUP}: {name!r}: expected a Task, found {type(task).__name__}")
    return task


def have_two_horizons(tasks: Iterable[str]) -> bool:
    """Whether the published code's horizon differs from the appendix's for any of the tasks."""
    return any(get_task(name).has_two_horizons for name in tasks)


def require_two_horizons(tasks: Iterable[str]) -> None:
    """Raise `UnknownNameError` unless `have_two_horizons`."""
    names = list(dict.fromkeys(tasks))
    if not have_two_horizons(names):
        found = ", ".join(f"{name} ({get_task(name).horizon} steps)" for name in names)
        raise UnknownNameError(
            "horizon 'published': expected a task that the published code runs for another number "
            f"of steps, found tasks with one horizon only: {found}; leave it out"
        )
