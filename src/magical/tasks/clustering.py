"""ClusterColour and ClusterShape but for their Demo scenes: attributes, scores (appendix A.2.7).

A block of attribute value a is correctly clustered when its squared distance to the centroid of
the blocks of value a is less than a third of that to the nearest other value's centroid. With f
the fraction of such blocks, the score is 0 up to f = 0.5 and rises linearly to 1 at f = 1.

The published code requires sqrt(own) < sqrt(nearest other) - 2 own, own and nearest other being
squared distances, and scores from f = 0.75 (docs/specification.md, section 9).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from magical.scene import COLOURS, SHAPES, Block, Poses, Scene
from magical.tasks.attributes import cycle_blocks, sample_count, sample_covering
from magical.tasks.axes import EVERYTHING, Axis
from magical.tasks.scoring import positions
from magical.tasks.task import ScoreFn, Task

HORIZON = 320  # control steps
PUBLISHED_HORIZON = 240  # control steps
BLOCKS = (7, 10)  # least and most in CountPlus
NO_SCORE_FRACTION = 0.5  # of blocks correctly clustered; the score is 0 up to here
PUBLISHED_NO_SCORE_FRACTION = 0.75

Attribute = Callable[[Block], str]
Distances = NDArray[np.float64]  # (number of blocks,) squared units


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """The number of blocks; their colours and shapes with each of the four values present."""
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
    """The appendix's score, 0 to 1 (appendix A.2.7)."""
    own, other = centroid_distances(scene, poses, attribute)
    return _above(float(np.mean(own < other / 3)), NO_SCORE_FRACTION)


def published_score(scene: Scene, poses: Poses, attribute: Attribute) -> float:
    """The published code's score, 0 to 1 (docs/specification.md, section 9)."""
    own, other = centroid_distances(scene, poses, attribute)
    clustered = np.sqrt(own) < np.sqrt(other) - 2 * own
    return _above(float(np.mean(clustered)), PUBLISHED_NO_SCORE_FRACTION)


def _above(fraction: float, least: float) -> float:
    return max(0.0, fraction - least) / (1.0 - least)


def centroid_distances(
    scene: Scene, poses: Poses, attribute: Attribute
) -> tuple[Distances, Distances]:
    """Squared distances to centroids.

    Returns:
        Two arrays (blocks,) in squared units: each block's squared distance to the centroid of its
        own value, and to the nearest centroid of another value.
    """
    values = [attribute(block) for block in scene.blocks]
    present = sorted(set(values))
    centres = np.array(positions(scene, poses))  # (blocks, 2)
    member = np.array([[value == a for a in present] for value in values])  # (blocks, values)
    centroids = (member.T @ centres) / member.sum(axis=0)[:, None]  # (values, 2)
    squared = np.square(centres[:, None] - centroids).sum(axis=2)  # (blocks, values)
    own = np.where(member, squared, np.inf).min(axis=1)
    other = np.where(member, np.inf, squared).min(axis=1)
    return own, other


def validate(scene: Scene, attribute: Attribute, expected: Sequence[str]) -> str:
    """The reason why the scene does not fit the task, or an empty string."""
    missing = [value for value in expected if value not in map(attribute, scene.blocks)]
    return f"expected at least one {' and one '.join(missing)} block, found none" if missing else ""


def make_task(
    what: str, demo: Scene, attribute: Attribute, values: Sequence[str], score_fn: ScoreFn
) -> Task:
    """The task that clusters blocks by `what`, an attribute with these values."""
    return Task(
        name=f"Cluster{what.capitalize()}",
        summary=f"Push the blocks into clusters of the same {what}.",
        section="A.2.7",
        horizon=HORIZON,
        published_horizon=PUBLISHED_HORIZON,
        demo=demo,
        axes=EVERYTHING,
        randomise_fn=randomise,
        score_fn=score_fn,
        published_score_fn=partial(published_score, attribute=attribute),
        max_blocks=BLOCKS[1],
        max_regions=0,
        validate_fn=partial(validate, attribute=attribute, expected=values),
    )
