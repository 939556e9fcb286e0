"""MakeLine: arrange all blocks in a line of any position and direction (appendix A.2.4)."""

from dataclasses import replace

import numpy as np

from magical.scene import Block, Colour, Pose, Poses, Scene, Shape
from magical.tasks.axes import EVERYTHING, Axis, cycle_blocks, sample_attributes, sample_count
from magical.tasks.scoring import longest_line, positions
from magical.tasks.task import Task

BLOCKS = (3, 4)  # minimum and maximum in CountPlus
PUBLISHED_SHORTEST = 3  # blocks: shorter lines score 0 in the published code


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample the number of blocks, and each block's colour and shape."""
    blocks = scene.blocks
    if Axis.COUNT in axes:
        blocks = cycle_blocks(blocks, sample_count(*BLOCKS, rng))
    return replace(scene, blocks=sample_attributes(blocks, axes, rng))


def _score(scene: Scene, poses: Poses) -> float:
    missing = len(scene.blocks) - longest_line(positions(scene, poses))
    return {0: 1.0, 1: 0.5}.get(missing, 0.0)


def _published_score(scene: Scene, poses: Poses) -> float:
    shortest = min(PUBLISHED_SHORTEST, len(scene.blocks))
    return _score(scene, poses) if longest_line(positions(scene, poses)) >= shortest else 0.0


TASK = Task(
    name="MakeLine",
    summary="Arrange all blocks in a line.",
    rule="""For a pair of blocks, the inliers are the blocks at most 0.18 units from the geometric
line through the pair. Sorted along it, they are split into subsets wherever neighbours are more
than 0.42 units apart. With n blocks and m the size of the largest subset over all pairs, the score
is 1 if m = n, 0.5 if m = n - 1, otherwise 0. Colours and shapes are ignored. In the published code,
two of three blocks in a line score 0.""",
    section="A.2.4",
    horizon=180,
    demo=Scene(
        robot=Pose(0.702, -0.255, 0.347),
        blocks=(
            Block(Shape.STAR, Colour.BLUE, Pose(0.790, -0.820, -0.721)),
            Block(Shape.CIRCLE, Colour.YELLOW, Pose(-0.177, 0.383, -1.733)),
            Block(Shape.STAR, Colour.RED, Pose(-0.051, -0.128, 2.696)),
            Block(Shape.PENTAGON, Colour.GREEN, Pose(-0.292, -0.745, -0.159)),
        ),
    ),
    axes=EVERYTHING,
    randomise_fn=randomise,
    score_fn=_score,
    published_score_fn=_published_score,
    min_blocks=2,
    max_blocks=BLOCKS[1],
)
