"""The programs of tasks, and the dense reward that follows from them."""

import re
from collections.abc import Callable

from magical.errors import UnknownNameError
from magical.scene import Poses, Scene
from magical.tasks import Task
from magical_goals.language.expressions import Floats
from magical_goals.language.generated import generated_program
from magical_goals.language.goals import Goal, progress
from magical_goals.language.parsing import parse

# What the paper's tasks ask for. For a task of your own, add its program.
PROGRAMS: dict[str, Goal] = {
    task: parse(program)
    for task, program in {
        "MoveToCorner": "Each(AllBlocks(), InCorner('top left'))",
        "MoveToRegion": "RobotInside()",
        "MatchRegions": "Exactly(OfRegionColour())",
        "MakeLine": "Lined(AllBlocks())",
        "FindDupe": "Together(OneOf(And(Outside(), LikeEnclosed('kind')), InRegion()), "
        "Together(Every(Enclosed(), InRegion()), Only(LikeEnclosed('kind'))))",
        "FixColour": "Together(Every(Mismatched(), OutOfRegions()), Undisturbed(Matched()))",
        "ClusterColour": "Clustered('colour')",
        "ClusterShape": "Clustered('shape')",
    }.items()
}


def program_of(task: str) -> Goal:
    """The program of a task.

    Raises:
        UnknownNameError: there is none for this task.
    """
    if task in PROGRAMS:
        return PROGRAMS[task]
    if re.fullmatch("Generated[0-9]{4}", task):
        return generated_program(task)
    raise UnknownNameError(
        f"{task} has no program; expected one of: {', '.join(PROGRAMS)}, or a generated task; add "
        f"it with magical_goals.language.programs.PROGRAMS[{task!r}] = parse(...)"
    )


def dense(task: Task) -> Callable[[Scene, Floats], float]:
    """The potential whose increase is the reward `dense`, of bodies (5 + N, 3 or more).

    It means nothing in scenes for which `problem` gives a reason, and is NaN if the program has no
    place there.

    Raises:
        UnknownNameError: the task has no program.
    """
    program = program_of(task.name)
    return lambda scene, bodies: progress(program, scene, Poses(bodies[:, :3]))
