"""The expert of the task in `outside_task`."""

from functools import partial
from typing import Any

from magical.experts import MovePlan, Planner, get_planner, register_planner


def plan(other: str, *arguments: Any) -> MovePlan:
    return get_planner(other).plan_fn(*arguments)


register_planner("MoveThere", Planner(partial(plan, "MoveToRegion")))
