"""Whether an episode can have a program as its goal in a given scene."""

import numpy as np

from magical.scene import Poses, Scene
from magical.tasks.programs.goals import SUCCESS, Clustered, Goal, Together, ways_at_start
from magical.tasks.programs.selections import Selection, value_of


def problem(goal: Goal, scene: Scene) -> str:
    """Why no episode can start from the scene with this goal, or an empty string."""
    for part in goal.parts:
        if isinstance(part, Selection) and not part.blocks(scene):
            return f"{part!r} selects no block of the scene"
        if isinstance(part, Goal) and (reason := _unreachable(part, scene)):
            return f"{part!r}: {reason}"
    if goal.score(scene, Poses.at_rest(scene)) > SUCCESS:
        return f"{goal!r} is solved at the start"
    return ""


def _unreachable(goal: Goal, scene: Scene) -> str:
    """Why no final state of the scene can reach the goal, or an empty string."""
    if isinstance(goal, Clustered):
        kinds = {value_of(block, goal.attribute) for block in scene.blocks}
        return "" if len(kinds) > 1 else "expected blocks of at least two values, found fewer"
    if isinstance(goal, Together):
        return ""
    reachable = np.isfinite(ways_at_start(goal, scene)).all(axis=1).any()
    return "" if reachable else "there is no such place in the scene"
