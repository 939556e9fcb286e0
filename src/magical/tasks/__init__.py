"""The tasks: Demo scenes, variants and scores. Each task has its own file; see `Task`."""

from magical.tasks.axes import CHANGES, VARIANTS, Axis
from magical.tasks.placement import Placement, validate_scene
from magical.tasks.registry import (
    TASKS,
    TaskFamily,
    discover,
    get_task,
    have_two_horizons,
    importable_tasks,
    load_task,
    load_tasks,
    possible_variants,
    register_task,
    require_two_horizons,
    suites,
    unregister_task,
    with_tasks,
)
from magical.tasks.task import MAX_HORIZON, Horizon, Task, format_horizon, parse_horizon

__all__ = [
    "CHANGES",
    "MAX_HORIZON",
    "TASKS",
    "VARIANTS",
    "Axis",
    "Horizon",
    "Placement",
    "Task",
    "TaskFamily",
    "format_horizon",
    "get_task",
    "have_two_horizons",
    "importable_tasks",
    "load_task",
    "load_tasks",
    "parse_horizon",
    "possible_variants",
    "register_task",
    "require_two_horizons",
    "suites",
    "unregister_task",
    "validate_scene",
    "with_tasks",
]

discover(__name__, __path__)
