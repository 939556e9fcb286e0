"""ClusterColour and ClusterShape, except for their Demo scenes (appendix A.2.7)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from magical.scene import COLOURS, SHAPES, Poses, Scene
from magical.tasks.attributes import cycle_blocks, sample_count, sample_covering
from magical.tasks.axes import EVERYTHING, Axis
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


def score(scene: Scene, poses: Poses, attribute: Attribute) -> float:
    """The appendix's score, 0 to 1."""
    own, other = _distances(scene, poses, attribute)
    fraction = float(np.mean(own < other / 3))
    return max(0.0, fraction - NO_SCORE) / (1.0 - NO_SCORE)


def published_score(scene: Scene, poses: Poses, attribute: Attribute) -> float:
    """The published code's score, 0 to 1 (docs/specification.md, section 9)."""
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


def make_task(attribute: Attribute, demo: Scene) -> Task:
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
        score_fn=partial(score, attribute=attribute),
        published_score_fn=partial(published_score, attribute=attribute),
        max_blocks=BLOCKS[1],
        max_regions=0,
        validate_fn=partial(_validate, attribute=attribute),
    )
