"""ClusterColour and ClusterShape: push the blocks into clusters of one value (appendix A.2.7)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from magical.scene import COLOURS, SHAPES, Block, Colour, Pose, Poses, Scene, Shape
from magical.tasks.axes import EVERYTHING, Axis, cycle_blocks, sample_count, sample_covering
from magical.tasks.scoring import Distances, centroid_distances, positions
from magical.tasks.task import Task

BLOCKS = (7, 10)  # minimum and maximum in CountPlus
NO_SCORE = 0.5  # fraction of blocks clustered up to which the score is 0
PUBLISHED_NO_SCORE = 0.75  # the same in the published code

Attribute = Literal["colour", "shape"]
VALUES: Mapping[Attribute, Sequence[str]] = {"colour": COLOURS, "shape": SHAPES}


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample the number of blocks, and their colours and shapes with all four values present."""
    count = sample_count(*BLOCKS, rng) if Axis.COUNT in axes else len(scene.blocks)
    blocks = cycle_blocks(scene.blocks, count)
    if Axis.COLOUR in axes:
        colours = sample_covering(COLOURS, count, rng)
        blocks = tuple(replace(b, colour=c) for b, c in zip(blocks, colours, strict=True))
    if Axis.SHAPE in axes:
        shapes = sample_covering(SHAPES, count, rng)
        blocks = tuple(replace(b, shape=s) for b, s in zip(blocks, shapes, strict=True))
    return replace(scene, blocks=blocks)


def _score(scene: Scene, poses: Poses, attribute: Attribute) -> float:
    own, other = _distances(scene, poses, attribute)
    fraction = float(np.mean(own < other / 3))
    return max(0.0, fraction - NO_SCORE) / (1.0 - NO_SCORE)


def _published_score(scene: Scene, poses: Poses, attribute: Attribute) -> float:
    own, other = _distances(scene, poses, attribute)
    fraction = float(np.mean(np.sqrt(own) < np.sqrt(other) - 2 * own))
    return max(0.0, fraction - PUBLISHED_NO_SCORE) / (1.0 - PUBLISHED_NO_SCORE)


def _distances(scene: Scene, poses: Poses, attribute: Attribute) -> tuple[Distances, Distances]:
    values = [getattr(block, attribute) for block in scene.blocks]
    return centroid_distances(values, np.array(positions(scene, poses)))


def _validate(scene: Scene, attribute: Attribute) -> str:
    values = {getattr(block, attribute) for block in scene.blocks}
    missing = [value for value in VALUES[attribute] if value not in values]
    return f"expected at least one {' and one '.join(missing)} block, found none" if missing else ""


def _make_task(attribute: Attribute, demo: Scene) -> Task:
    """The task of clustering blocks by an attribute."""
    return Task(
        name=f"Cluster{attribute.capitalize()}",
        summary=f"Push the blocks into clusters of the same {attribute}.",
        rule=f"""A block is correctly clustered when its squared distance to the centroid of its own
{attribute} is less than a third of that to the nearest centroid of another {attribute}. The score
rises linearly from 0 to 1 as the fraction of such blocks rises from 0.5 to 1. The published code
requires sqrt(own) < sqrt(nearest other) - 2 own, where own and nearest other are the squared
distances, and its score rises from 0.75.""",
        section="A.2.7",
        horizon=320,
        published_horizon=240,
        demo=demo,
        axes=EVERYTHING,
        randomise_fn=randomise,
        score_fn=partial(_score, attribute=attribute),
        published_score_fn=partial(_published_score, attribute=attribute),
        max_blocks=BLOCKS[1],
        validate_fn=partial(_validate, attribute=attribute),
    )


CLUSTER_COLOUR = _make_task(
    "colour",
    Scene(
        robot=Pose(0.71692, -0.34374, 0.83693),
        blocks=(
            Block(Shape.CIRCLE, Colour.BLUE, Pose(-0.5147, 0.14149, -0.38871)),
            Block(Shape.STAR, Colour.BLUE, Pose(-0.1347, -0.71414, 1.0533)),
            Block(Shape.SQUARE, Colour.BLUE, Pose(-0.74247, -0.097592, 1.1571)),
            Block(Shape.PENTAGON, Colour.GREEN, Pose(-0.077363, -0.42964, -0.64379)),
            Block(Shape.PENTAGON, Colour.GREEN, Pose(0.51978, 0.1853, -1.1762)),
            Block(Shape.SQUARE, Colour.RED, Pose(-0.5278, -0.21642, 2.9356)),
            Block(Shape.STAR, Colour.YELLOW, Pose(-0.54039, 0.48292, 0.072818)),
            Block(Shape.PENTAGON, Colour.YELLOW, Pose(-0.16761, 0.64303, -2.3255)),
        ),
    ),
)

CLUSTER_SHAPE = _make_task(
    "shape",
    Scene(
        robot=Pose(0.286, -0.202, -1.878),
        blocks=(
            Block(Shape.SQUARE, Colour.YELLOW, Pose(-0.414, 0.297, -1.731)),
            Block(Shape.PENTAGON, Colour.BLUE, Pose(0.068, 0.705, 2.184)),
            Block(Shape.PENTAGON, Colour.RED, Pose(0.821, 0.220, 0.650)),
            Block(Shape.PENTAGON, Colour.RED, Pose(-0.461, -0.749, -2.673)),
            Block(Shape.CIRCLE, Colour.GREEN, Pose(0.867, -0.149, -2.215)),
            Block(Shape.STAR, Colour.YELLOW, Pose(-0.785, -0.140, -0.405)),
            Block(Shape.STAR, Colour.BLUE, Pose(-0.305, -0.226, 1.341)),
            Block(Shape.CIRCLE, Colour.GREEN, Pose(0.758, -0.708, -2.140)),
        ),
    ),
)
