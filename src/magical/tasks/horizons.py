"""Horizons: the appendix's, the published code's where it differs, or a number of steps."""

import operator
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Final

import numpy as np

from magical.errors import InvalidConfigError, UnknownNameError
from magical.messages import quoted
from magical.tasks.registry import get_task
from magical.tasks.task import Horizon

APPENDIX: Final = "appendix"
PUBLISHED: Final = "published"
MAX_HORIZON = int(np.iinfo(np.int64).max)


def parse_horizon(value: Any) -> Horizon:
    """From "appendix", "published" or a number of steps; `InvalidConfigError` for anything else."""
    if value is None or (isinstance(value, str) and value in (APPENDIX, PUBLISHED)):
        return PUBLISHED if value == PUBLISHED else None
    with suppress(TypeError, ValueError):
        steps = int(value) if isinstance(value, str) else operator.index(value)
        if 1 <= steps <= MAX_HORIZON and not isinstance(value, bool):
            return steps
    raise InvalidConfigError(
        f"horizon: expected {APPENDIX}, {PUBLISHED} or a number of control steps from 1 to "
        f"{MAX_HORIZON}, found {quoted(value)}"
    )


def format_horizon(horizon: Horizon) -> str:
    """The inverse of `parse_horizon`, for records and messages."""
    return APPENDIX if horizon is None else str(horizon)


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
