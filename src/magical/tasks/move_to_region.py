"""MoveToRegion: drive the robot into the goal region (appendix A.2.2). There are no blocks."""

from dataclasses import replace

import numpy as np

from magical.scene import COLOURS, Colour, Pose, Poses, Region, Scene
from magical.tasks.axes import Axis, sample_item
from magical.tasks.task import Task


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample the region's colour."""
    if Axis.COLOUR not in axes:
        return scene
    return replace(scene, regions=(replace(scene.regions[0], colour=sample_item(COLOURS, rng)),))


def _score(scene: Scene, poses: Poses) -> float:
    return float(scene.regions[0].contains(*poses.robot[:2]))


TASK = Task(
    name="MoveToRegion",
    summary="Drive the robot into the goal region.",
    rule="The score is 1 if the centre of the robot's body ends inside the goal region, else 0.",
    section="A.2.2",
    horizon=40,
    demo=Scene(
        robot=Pose(0.058, 0.53, -2.13),
        regions=(Region(Colour.BLUE, x=-0.62, y=-0.17, height=0.76, width=0.75),),
    ),
    axes=Axis.JITTER | Axis.LAYOUT | Axis.COLOUR | Axis.DYNAMICS,
    randomise_fn=randomise,
    score_fn=_score,
    instruction_fn=lambda scene: f"Drive into the {scene.regions[0].colour} region.",
    min_regions=1,
    max_regions=1,
)
