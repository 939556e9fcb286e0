"""FixColour: push the mismatched block out of its goal region (appendix A.2.6).

Each goal region starts with one block inside, block i in region i. Exactly one block, the
mismatched one, differs in colour from its region.
"""

from dataclasses import replace

import numpy as np

from magical.scene import COLOURS, Block, Colour, Pose, Poses, Region, Scene, Shape
from magical.tasks.axes import (
    EVERYTHING,
    Axis,
    cycle_blocks,
    name_blocks,
    sample_attributes,
    sample_count,
    sample_item,
)
from magical.tasks.placement import Placement
from magical.tasks.scoring import blocks_inside
from magical.tasks.task import Task

PAIRS = (2, 3)  # minimum and maximum number of pairs in CountPlus


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample the number of pairs, the blocks' shapes, the regions' colours and the mismatch."""
    count = sample_count(*PAIRS, rng) if Axis.COUNT in axes else len(scene.blocks)
    blocks = list(sample_attributes(cycle_blocks(scene.blocks, count), axes & Axis.SHAPE, rng))
    regions = scene.regions[:count]
    if Axis.COLOUR in axes:
        regions = tuple(replace(region, colour=sample_item(COLOURS, rng)) for region in regions)
        colours = [region.colour for region in regions]
        odd = sample_count(0, count - 1, rng)
        colours[odd] = sample_item([colour for colour in COLOURS if colour != colours[odd]], rng)
        blocks = [replace(b, colour=c) for b, c in zip(blocks, colours, strict=True)]
    return replace(scene, blocks=tuple(blocks), regions=regions)


def mismatched(scene: Scene) -> list[int]:
    """Indices of the blocks of another colour than their regions: one, in a scene of the task."""
    pairs = zip(scene.blocks, scene.regions, strict=True)
    return [i for i, (block, region) in enumerate(pairs) if block.colour != region.colour]


def _score(scene: Scene, poses: Poses) -> float:
    (odd,) = mismatched(scene)
    inside = [blocks_inside(region, scene, poses) for region in scene.regions]
    left = odd not in inside.pop(odd)
    return float(left and inside == [{i} for i in range(len(scene.blocks)) if i != odd])


def _instruction(scene: Scene) -> str:
    (odd,), blocks = mismatched(scene), list(scene.blocks)
    kinds = [(block.colour, block.shape) for block in blocks]
    if kinds.count(kinds[odd]) > 1:  # colours and shapes do not tell them apart
        return (
            "Push every block that is inside a region of another colour out of any region. Keep "
            "every block that is inside a region of its own colour where it is."
        )
    name, others = name_blocks([blocks.pop(odd)]), name_blocks(blocks)
    where = "where it is" if len(blocks) == 1 else "where they are"
    return f"Push {name} out of any region. Keep {others} {where}."


def _validate(scene: Scene) -> str:
    if len(scene.blocks) != len(scene.regions):
        return f"expected a region for every block, found {len(scene.regions)} regions"
    if len(odd := mismatched(scene)) != 1:
        return f"expected exactly 1 block of another colour than its region, found {len(odd)}"
    return ""


TASK = Task(
    name="FixColour",
    summary="Push the block that differs in colour from its goal region out of the region.",
    rule="""The score is 1 if the mismatched block ends outside its region while every other region
contains exactly the block that it started with, otherwise 0.""",
    section="A.2.6",
    horizon=60,
    demo=Scene(
        robot=Pose(0.368, 0.586, 0.718),
        blocks=(
            Block(Shape.PENTAGON, Colour.GREEN, Pose(0.289, 0.030, 0.307)),
            Block(Shape.SQUARE, Colour.GREEN, Pose(0.133, -0.561, 1.699)),
            Block(Shape.PENTAGON, Colour.BLUE, Pose(-0.336, 0.000, -1.529)),
        ),
        regions=(
            Region(Colour.GREEN, x=-0.032, y=0.348, height=0.427, width=0.468),
            Region(Colour.GREEN, x=0.019, y=-0.391, height=0.460, width=0.458),
            Region(Colour.RED, x=-0.681, y=0.196, height=0.498, width=0.418),
        ),
    ),
    axes=EVERYTHING,
    randomise_fn=randomise,
    placement=Placement(region_size=(0.4, 0.5), encloses=True, margin=0.12),
    score_fn=_score,
    instruction_fn=_instruction,
    max_blocks=PAIRS[1],
    max_regions=PAIRS[1],
    validate_fn=_validate,
)
