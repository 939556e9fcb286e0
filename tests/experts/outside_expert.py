"""The expert of the task in `outside_task`."""

from typing import Any

from magical.experts import Goals, Plan, get_goals, register_goals


def plan(*arguments: Any) -> Plan:
    return get_goals("MoveToRegion").plan_fn(*arguments)


register_goals("MoveThere", Goals(plan))
