"""MoveToCorner: push the block from the bottom right to the top left corner (appendix A.2.1).

Without Layout and CountPlus, which would leave open which corner or which block is meant.
"""

import math
from dataclasses import replace

import numpy as np

from magical.scene import Block, Colour, Pose, Poses, Scene, Shape
from magical.scene.constants import WORKSPACE_HALF
from magical.tasks.axes import Axis, name_blocks, sample_attributes
from magical.tasks.scoring import positions
from magical.tasks.task import Task

GOAL = (-WORKSPACE_HALF, WORKSPACE_HALF)  # the top left corner
NO_SCORE = math.sqrt(2.0)  # units from the corner: no score from here on
FULL_SCORE = NO_SCORE / 2  # units: full score within


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample the block's colour and shape."""
    return replace(scene, blocks=sample_attributes(scene.blocks, axes, rng))


def _score(scene: Scene, poses: Poses) -> float:
    left = NO_SCORE - math.dist(positions(scene, poses)[0], GOAL)
    return min(max(left / (NO_SCORE - FULL_SCORE), 0.0), 1.0)


TASK = Task(
    name="MoveToCorner",
    summary="Push the block from the bottom right corner to the top left corner.",
    rule="""The score is 1 if the block's centre ends within sqrt(2)/2 units of the top left corner
of the workspace, 0 beyond sqrt(2) units, and linear in the distance between.""",
    section="A.2.1",
    horizon=80,
    demo=Scene(
        robot=Pose(0.4, 0.0, 0.55 * math.pi),
        blocks=(Block(Shape.SQUARE, Colour.RED, Pose(0.1, -0.65, 0.13 * math.pi)),),
        robot_first=True,
    ),
    axes=Axis.JITTER | Axis.COLOUR | Axis.SHAPE | Axis.DYNAMICS,
    randomise_fn=randomise,
    score_fn=_score,
    instruction_fn=lambda scene: f"Push {name_blocks(scene.blocks)} to the top left corner.",
    min_blocks=1,
    max_blocks=1,
)
