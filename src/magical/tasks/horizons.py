"""Which tasks the published code runs for another number of steps than the appendix says."""

from collections.abc import Iterable

from magical.errors import UnknownNameError
from magical.tasks.registry import TASKS, get_task


def have_two_horizons(tasks: Iterable[str]) -> bool:
    """Whether the published code's horizon differs from the appendix's for any of the tasks.

    Raises `UnknownNameError` for an unknown task.
    """
    return any(get_task(name).has_two_horizons for name in tasks)


def require_two_horizons(tasks: Iterable[str]) -> None:
    """Check that asking for the published code's horizon changes anything.

    Raises:
        UnknownNameError: each of the tasks has one horizon only, or there is no such task.
    """
    names = list(dict.fromkeys(tasks))
    if have_two_horizons(names):
        return
    found = ", ".join(f"{name} ({get_task(name).horizon} steps)" for name in names)
    expected = ", ".join(task.name for task in TASKS.values() if task.has_two_horizons)
    raise UnknownNameError(
        f"horizon 'published': expected a task that the published code runs for another number of "
        f"steps ({expected}), found tasks with one horizon only: {found}; leave the horizon out"
    )
