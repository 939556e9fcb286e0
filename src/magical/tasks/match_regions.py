"""MatchRegions: move all and only blocks of the goal region's colour into it (appendix A.2.3)."""

import math
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
from magical.tasks.scoring import blocks_inside
from magical.tasks.task import Task

TARGETS = (1, 2)  # minimum and maximum in CountPlus
DISTRACTORS = (0, 2)  # minimum and maximum of each other colour in CountPlus


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample the target colour (the others follow in order), numbers of blocks and shapes."""
    region, blocks = scene.regions[0], scene.blocks
    target = sample_item(COLOURS, rng) if Axis.COLOUR in axes else region.colour
    renamed = dict(zip(_target_first(region.colour), _target_first(target), strict=True))
    colours = [renamed[block.colour] for block in blocks]
    if Axis.COUNT in axes:
        counts = [sample_count(*TARGETS, rng), *(sample_count(*DISTRACTORS, rng) for _ in range(3))]
        groups = zip(_target_first(target), counts, strict=True)
        colours = [colour for colour, count in groups for _ in range(count)]
    blocks = tuple(
        replace(block, colour=colour)
        for block, colour in zip(cycle_blocks(blocks, len(colours)), colours, strict=True)
    )
    return replace(
        scene,
        blocks=sample_attributes(blocks, axes & Axis.SHAPE, rng),
        regions=(replace(region, colour=target),),
    )


def _target_first(target: Colour) -> list[Colour]:
    return [target, *(colour for colour in COLOURS if colour != target)]


def targets(scene: Scene) -> set[int]:
    """Indices of the blocks of the region's colour; the others are distractors."""
    return {i for i, b in enumerate(scene.blocks) if b.colour == scene.regions[0].colour}


def _score(scene: Scene, poses: Poses) -> float:
    wanted, inside = targets(scene), blocks_inside(scene.regions[0], scene, poses)
    if not inside:
        return 0.0
    return len(wanted & inside) / len(wanted) * (1.0 - len(inside - wanted) / len(inside))


def _instruction(scene: Scene) -> str:
    region = f"the {scene.regions[0].colour} region"
    names = name_blocks([scene.blocks[i] for i in sorted(targets(scene))])
    return f"Push {names} into {region}. Keep all other blocks out of {region}."


def _validate(scene: Scene) -> str:
    if targets(scene):
        return ""
    return f"expected a block of the region's colour {scene.regions[0].colour}, found none; add one"


TASK = Task(
    name="MatchRegions",
    summary="Gather all blocks of the goal region's colour, and only those, in the region.",
    rule="""With T the target blocks (of the region's colour), D the distractors (of other colours)
and R the blocks that end inside the region, the score is

    |T & R| / |T|  x  (1 - |D & R| / |R|)      (0 if R is empty).""",
    section="A.2.3",
    horizon=120,
    # Targets first, then distractors by colour in the vocabulary's order.
    demo=Scene(
        robot=Pose(-0.5, 0.1, -1.2 * math.pi),
        blocks=(
            Block(Shape.STAR, Colour.GREEN, Pose(0.8, -0.7, 2.37)),
            Block(Shape.SQUARE, Colour.GREEN, Pose(-0.68, 0.72, 1.28)),
            Block(Shape.PENTAGON, Colour.BLUE, Pose(-0.05, -0.2, -1.09)),
            Block(Shape.CIRCLE, Colour.YELLOW, Pose(-0.75, -0.55, 2.78)),
            Block(Shape.PENTAGON, Colour.YELLOW, Pose(0.3, -0.82, -1.15)),
        ),
        regions=(Region(Colour.GREEN, x=0.1, y=0.7, height=0.7, width=0.6),),
    ),
    axes=EVERYTHING,
    randomise_fn=randomise,
    score_fn=_score,
    instruction_fn=_instruction,
    max_blocks=TARGETS[1] + DISTRACTORS[1] * (len(COLOURS) - 1),
    min_regions=1,
    max_regions=1,
    validate_fn=_validate,
)
