"""EmptyRegion: push the block out of the goal region.

The score is 1 if the block's centre ends outside the region, otherwise 0.

Horizon: 60 control steps.

Variants: Jitter, Colour, Shape, Dynamics and All.
"""

from dataclasses import replace

import numpy as np

from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.scene import Block, Colour, Pose, Poses, Region, Scene, Shape
from magical.tasks import Axis, Task
from magical.tasks.axes import sample_attributes
from magical.tasks.placement import Placement

OUTSIDE = 0.75  # units up: where the expert puts the block
SPREAD = 0.6  # units to either side, over which demonstrators differ
MARGIN = 0.15  # units from the block's centre to the region's edge at the start

DEMO = Scene(
    robot=Pose(0.0, -0.75, 0.0),
    blocks=(Block(Shape.SQUARE, Colour.RED, Pose(0.0, -0.1, 0.4)),),
    regions=(Region(Colour.BLUE, x=-0.35, y=0.2, height=0.6, width=0.7),),
)


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """The block's colour and shape."""
    return replace(scene, blocks=sample_attributes(scene.blocks, axes, rng))


def score(scene: Scene, poses: Poses) -> float:
    """Whether the block's centre is outside the goal region, 0 or 1."""
    x, y = poses.blocks[0][:2]
    return float(not scene.regions[0].contains(x, y))


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Bring the block to a place outside, if it is not outside already."""
    if not view.scene.regions[0].contains(*view.blocks[0]):
        return MovePlan()
    x = SPREAD * (2 * strategy.placements[0] - 1)
    return MovePlan((Move((x, OUTSIDE), tolerance=0.1, block=0),))


TASK = Task(
    name="EmptyRegion",
    summary="Push the block out of the goal region.",
    horizon=60,
    demo=DEMO,
    axes=Axis.JITTER | Axis.COLOUR | Axis.SHAPE | Axis.DYNAMICS,
    randomise_fn=randomise,
    placement=Placement(encloses=True, margin=MARGIN),
    score_fn=score,
    max_blocks=1,
    max_regions=1,
)
PLANNER = Planner(plan)
