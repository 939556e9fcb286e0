"""The dense reward: a potential that measures the progress of a task's program."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from magical.errors import UnknownNameError
from magical.scene import Poses, Scene
from magical.tasks.programs.goals import progress
from magical.tasks.registry import importable_tasks
from magical.tasks.task import Task


def dense(task: Task) -> Callable[[Scene, NDArray[np.float64]], float]:
    """The potential of a task's program; raises `UnknownNameError` for a task without one."""
    program = task.program
    if program is None:
        having = [other.name for other in importable_tasks() if other.program is not None]
        raise UnknownNameError(
            f"{task.name} has no dense reward; expected one of: {', '.join(having)}"
        )
    return lambda scene, bodies: progress(program, scene, Poses(bodies[:, :3]))
