"""Rows of tables: the runs of a method that were evaluated in the same way."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from magical.envs.action_spec import DISCRETE
from magical.evaluation import Entry
from magical.evaluation.protocol import ROLLOUTS, SEED, Evaluated
from magical.grouping import group_by
from magical.tasks.horizons import APPENDIX, PUBLISHED

T = TypeVar("T")


def by_row(items: Iterable[T], entry_of: Callable[[T], Entry]) -> dict[str, list[T]]:
    """Group entries, or what has one, into rows of tables, by the rows' labels.

    The entries of a row have the same method and were evaluated in the same way: with equal
    settings and, on a task that several of them have, with the same horizon. They may have other
    tasks and variants than each other: every cell of a table is of one environment.

    A label is the method's name, then the settings in which the rows of this method differ, except
    those of the protocol. A nudge is always named.
    """
    rows: dict[str, list[T]] = {}
    for method, of_method in group_by(items, lambda item: entry_of(item).method).items():
        found = [(item, entry_of(item).evaluated) for item in of_method]
        parts = [
            ({**dict(settings), "horizon": horizon}, [item for item, _ in part])
            for settings, alike in group_by(found, _settings).items()
            for horizon, part in _by_horizon(alike).items()
        ]
        for settings, part in parts:
            label = ", ".join([method, *_differences(settings, [other for other, _ in parts])])
            while label in rows:  # another method has this name
                label += " (2)"
            rows[label] = part
    return rows


def _settings(found: tuple[T, Evaluated]) -> tuple[tuple[str, Any], ...]:
    """Everything that scores depend on, except environments and horizon."""
    return tuple((found[1].settings | {"horizon": None}).items())


def _by_horizon(
    found: Sequence[tuple[T, Evaluated]],
) -> Mapping[str, Sequence[tuple[T, Evaluated]]]:
    """Evaluations by the horizon in words, or all together if no task has several horizons.

    Runs of single tasks share a row although tasks with one horizon are never evaluated with the
    published one, and the others may be.
    """
    groups = group_by(found, lambda pair: _horizon(pair[1]))
    known: dict[str, int] = {}
    for _, evaluated in found:
        for task, steps in _steps(evaluated).items():
            if known.setdefault(task, steps) != steps:
                return groups
    return {" and ".join(name for name in groups if name != APPENDIX) or APPENDIX: found}


def _steps(evaluated: Evaluated) -> dict[str, int]:
    """The number of control steps on each task."""
    tasks = {env_id.task: env_id.task_spec for env_id in evaluated.env_ids}
    return {name: task.resolve_horizon(evaluated.horizon) for name, task in tasks.items()}


def _horizon(evaluated: Evaluated) -> str:
    """The horizon in words: the same for the same numbers of steps on the same tasks."""
    if evaluated.horizon_name == APPENDIX:
        return APPENDIX
    steps = set(_steps(evaluated).values())
    return str(steps.pop()) if len(steps) == 1 else PUBLISHED


def _differences(settings: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> list[str]:
    """What distinguishes a row from the others of its method, in words."""
    rollouts, actions = settings["rollouts"], settings["action_space"]
    said = {
        "observation": settings["observation"],
        "privileged": "privileged" if settings["privileged"] else "",
        "action_space": actions if actions != DISCRETE.name else "",
        "horizon": f"horizon {settings['horizon']}" if settings["horizon"] != APPENDIX else "",
        "rollouts": f"{rollouts} rollout{'s' * (rollouts > 1)}" if rollouts != ROLLOUTS else "",
        "seed": f"seed {settings['seed']}" if settings["seed"] != SEED else "",
    }
    differ = [name for name in said if any(other[name] != settings[name] for other in others)]
    words = [said[name] for name in differ if said[name]]
    return [*words, f"nudge {settings['nudge']:g}"] if settings["nudge"] else words
