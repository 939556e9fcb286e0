"""The goals of each task as moves of blocks and robot: the planners of the experts.

Other packages provide theirs by entry points in the group `magical.experts`, named after the task
(or by a pattern, a function from a task's name to its planner), or call `register_planner`.
"""

from operator import attrgetter

from magical.errors import NoExpertError, PluginError
from magical.experts.goals import make_line, regions
from magical.experts.goals.clustering import cluster_planner
from magical.experts.planning import Planner
from magical.plugins import is_offered, load_plugin
from magical.tasks import TASKS

GROUP = "magical.experts"

_planners = {
    "MoveToCorner": Planner(regions.move_to_corner),
    "MoveToRegion": Planner(regions.move_to_region),
    "MatchRegions": Planner(regions.match_regions),
    "MakeLine": Planner(make_line.plan, make_line.is_solved),
    "FindDupe": Planner(regions.find_dupe),
    "FixColour": Planner(regions.fix_colour),
    "ClusterColour": cluster_planner(attrgetter("colour")),
    "ClusterShape": cluster_planner(attrgetter("shape")),
}


def register_planner(task: str, planner: Planner) -> None:
    """Register a task's planner, replacing any that it already has.

    Worker processes import the module of its plan function, which should make this call.

    Raises:
        PluginError: it is something else.
    """
    if not isinstance(planner, Planner):
        raise PluginError(f"{GROUP}: {task!r}: expected Planner, found {type(planner).__name__}")
    _planners[task] = planner


def get_planner(task: str) -> Planner:
    """The planner of a task's expert.

    Raises:
        NoExpertError: the task has no expert; the message says how to add one.
        PluginError: another package's planner cannot be imported, or is not a `Planner`.
    """
    if not has_expert(task):
        known = ", ".join(name for name in TASKS if has_expert(name))
        raise NoExpertError(
            f"{task!r} has no scripted expert; expected one of: {known}; add an "
            f"entry point {task} of the group {GROUP}, or call "
            f"magical.experts.register_planner({task!r}, Planner(...))"
        )
    if task not in _planners:
        register_planner(task, load_plugin(GROUP, task))
    return _planners[task]


def has_expert(task: str) -> bool:
    """Whether a task has a scripted expert; another package's is not imported."""
    return task in _planners or is_offered(GROUP, task)
