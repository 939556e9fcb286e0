"""The expert of the task in `outside_task`."""

from typing import Any

from magical.experts import Goals, Plan, goals_of, register_goals


def plan(*arguments: Any) -> Plan:
    return goals_of("MoveToRegion").plan(*arguments)


register_goals("MoveThere", Goals(plan))
