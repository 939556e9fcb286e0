"""FindDupe: push a duplicate of the query block into the goal region (appendix A.2.5).

The query block starts inside the region. The order of blocks is outside blocks, duplicate, query.
"""

from dataclasses import replace

import numpy as np

from magical.scene import Block, Colour, Pose, Poses, Region, Scene, Shape
from magical.tasks.axes import EVERYTHING, Axis, cycle_blocks, sample_attributes, sample_count
from magical.tasks.placement import Placement
from magical.tasks.scoring import blocks_inside
from magical.tasks.task import Task

OTHERS = (1, 5)  # minimum and maximum number of outside blocks, without the duplicate, in CountPlus


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample the query's colour and shape, and the others' number, colours and shapes."""
    *others, duplicate, query = scene.blocks
    (query,) = sample_attributes([query], axes, rng)
    if Axis.COUNT in axes:
        others = list(cycle_blocks(others, sample_count(*OTHERS, rng)))
    duplicate = replace(query, pose=duplicate.pose)
    return replace(
        scene,
        blocks=(*sample_attributes(others, axes, rng), duplicate, query),
        regions=(replace(scene.regions[0], colour=query.colour),),
    )


def _score(scene: Scene, poses: Poses) -> float:
    query_stays = len(scene.blocks) - 1 in blocks_inside(scene.regions[0], scene, poses)
    return _published_score(scene, poses) if query_stays else 0.0


def _published_score(scene: Scene, poses: Poses) -> float:
    kind, inside = alike(scene), blocks_inside(scene.regions[0], scene, poses)
    return len(inside & kind) / len(inside) if len(kind & inside) > 1 else 0.0


def alike(scene: Scene) -> set[int]:
    """Indices of the query and all blocks of its shape and colour; the rest are distractors."""
    query = scene.blocks[-1]
    wanted = query.shape, query.colour
    return {i for i, block in enumerate(scene.blocks) if (block.shape, block.colour) == wanted}


def _instruction(scene: Scene) -> str:
    kind, region = f"{scene.blocks[-1].colour} {scene.blocks[-1].shape}", scene.regions[0].colour
    duplicate = f"the {kind} that is outside" if len(alike(scene)) == 2 else f"one {kind}"
    return (
        f"Push {duplicate} into the {region} region. Keep the {kind} that is inside where it is. "
        f"Keep all other blocks out of the {region} region."
    )


def _validate(scene: Scene) -> str:
    if len(alike(scene)) > 1:
        return ""
    return "expected a duplicate of the last block (the query), found none; add one"


TASK = Task(
    name="FindDupe",
    summary="Push a duplicate of the query block, which is in the goal region, into that region.",
    rule="""With q the query block, T the other blocks of its shape and colour, D the distractors
and R the blocks that end inside the region, the score is

    [q in R]  x  [T & R not empty]  x  (1 - |D & R| / |R|).

In the published code, any two blocks like the query suffice, and q need not stay.""",
    section="A.2.5",
    horizon=100,
    demo=Scene(
        robot=Pose(-0.57, 0.25, 3.83),
        blocks=(
            Block(Shape.PENTAGON, Colour.GREEN, Pose(-0.066751, 0.7552, -2.9266)),
            Block(Shape.CIRCLE, Colour.RED, Pose(-0.05195, 0.31468, 1.5418)),
            Block(Shape.CIRCLE, Colour.RED, Pose(0.57528, -0.46865, -2.2141)),
            Block(Shape.SQUARE, Colour.YELLOW, Pose(0.40594, -0.74977, 0.24582)),
            Block(Shape.STAR, Colour.BLUE, Pose(0.45254, 0.3681, -1.0834)),
            Block(Shape.PENTAGON, Colour.YELLOW, Pose(0.76849, -0.10652, 0.10028)),
            Block(Shape.PENTAGON, Colour.YELLOW, Pose(-0.33, -0.49, -0.51)),
        ),
        regions=(Region(Colour.YELLOW, x=-0.72, y=-0.22, height=0.67, width=0.72),),
    ),
    axes=EVERYTHING,
    randomise_fn=randomise,
    placement=Placement(encloses=True, margin=0.06),
    score_fn=_score,
    instruction_fn=_instruction,
    published_score_fn=_published_score,
    min_blocks=2,
    max_blocks=OTHERS[1] + 2,
    min_regions=1,
    max_regions=1,
    validate_fn=_validate,
)
