"""The expert of the task in `outside_task`."""

from typing import Any

from magical.experts import MovePlan, Planner, get_planner, register_planner


def plan(*arguments: Any) -> MovePlan:
    return get_planner("MoveToRegion").plan_fn(*arguments)


register_planner("MoveThere", Planner(plan))
