"""The programs of tasks, and the dense reward that follows from them."""

import re
from collections.abc import Callable

from magical.errors import UnknownNameError
from magical.scene import Poses, Scene
from magical.tasks import Task
from magical_goals.language.expressions import Floats
from magical_goals.language.generated import generate
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
    """The program of a task; raises `UnknownNameError` if there is none."""
    if task in PROGRAMS:
        return PROGRAMS[task]
    if re.fullmatch("Generated[0-9]{4}", task):
        return generate(task)[1]
    raise UnknownNameError(
        f"{task} has no program; expected one of: {', '.join(PROGRAMS)}, or a generated task; add "
        f"it with magical_goals.language.programs.PROGRAMS[{task!r}] = parse(...)"
    )


def dense(task: Task) -> Callable[[Scene, Floats], float]:
    """The potential whose increase is the reward `dense`, of bodies (5 + N, 3 or more).

    It means nothing in scenes for which `problem` gives a reason, and may be NaN there.
    """
    program = program_of(task.name)
    return lambda scene, bodies: progress(program, scene, Poses(bodies[:, :3]))
