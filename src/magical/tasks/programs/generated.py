"""Generated tasks: a number determines a program, a Demo scene and all variants.

The tasks are called Generated0000 to Generated9999. What a number determines changes only with
`GENERATOR`, which corresponds to the version in the ids of their environments.
"""

import math
import re
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from itertools import combinations

import numpy as np

from magical.errors import InvalidProgramError, PlacementError
from magical.scene import COLOURS, SHAPES, Block, Pose, Region, Scene
from magical.scene.constants import STAR_OUTER_RADIUS, WORKSPACE_HALF
from magical.scene.solids import Solid
from magical.tasks.attributes import cycle_blocks, sample_attributes, sample_count, sample_item
from magical.tasks.axes import EVERYTHING, Axis
from magical.tasks.placement import Placement, sample_placement
from magical.tasks.programs import Clustered, Goal, instruction, problem
from magical.tasks.programs.sampling import Family, sample_program
from magical.tasks.task import Task

GENERATOR = 0  # the version of everything that a number's task depends on
NAME = re.compile("Generated[0-9]{4}")
MAX_PROGRAMS = 100  # sampled at most for one number
MAX_SCENES = 200  # sampled at most for one program
MAX_MOVED = 3  # blocks that a goal may be about at most, except for clusters
MORE_OUTSIDE = 2  # blocks outside the regions that CountPlus may add to the family's maximum
REGION_SIZE = (0.45, 0.7)  # units
MARGIN = 0.12  # units from an enclosed block's centre to its region's nearest edge


def is_generated(name: str) -> bool:
    """Whether a name is that of a generated task."""
    return NAME.fullmatch(name) is not None


@cache
def generated_task(name: str) -> Task:
    """The task with a name such as Generated0042.

    Raises:
        InvalidProgramError: none of the sampled programs has a suitable scene.
    """
    rng = np.random.default_rng([GENERATOR, int(name.removeprefix("Generated"))])
    for _ in range(MAX_PROGRAMS):
        family, program = sample_program(rng)
        if (demo := _sample_demo(family, program, rng)) is not None:
            task = _make_task(name, family, program, demo)
            with suppress(PlacementError):  # the program may rule out a variant
                for variant in task.variants:
                    task.sample(variant, rng)
                return task
    raise InvalidProgramError(f"{name}: found no scene for any of {MAX_PROGRAMS} programs")


def _make_task(name: str, family: Family, program: Goal, demo: Scene) -> Task:
    enclosed = len(demo.regions) if family.encloses else 0
    most = family.outside[1] + MORE_OUTSIDE
    return Task(
        name=name,
        summary=instruction(program, demo, attributes=False),
        horizon=family.horizon,
        demo=demo,
        axes=EVERYTHING,
        randomise_fn=partial(randomise, enclosed=enclosed, most=most),
        placement=_placement(family),
        program=program,
        score_fn=program.score,
        max_blocks=most + enclosed,
        max_regions=len(demo.regions),
        validate_fn=partial(misfit, program=program),
    )


def _placement(family: Family) -> Placement:
    return Placement(region_size=REGION_SIZE, encloses=family.encloses, margin=MARGIN)


def randomise(
    scene: Scene, axes: Axis, rng: np.random.Generator, enclosed: int, most: int
) -> Scene:
    """Sample uniform colours and shapes, and up to `most` blocks outside the regions."""
    outside = len(scene.blocks) - enclosed
    count = outside
    if Axis.COUNT in axes and outside:
        count = sample_count(min(2, outside), most, rng)
    regions = scene.regions
    if Axis.COLOUR in axes:
        regions = tuple(replace(region, colour=sample_item(COLOURS, rng)) for region in regions)
    blocks = (*cycle_blocks(scene.blocks[:outside], count), *scene.blocks[outside:])
    return replace(scene, blocks=sample_attributes(blocks, axes, rng), regions=regions)


def misfit(scene: Scene, program: Goal) -> str:
    """Why the scene does not fit the program as a generated task, or an empty string."""
    if reason := problem(program, scene):
        return reason
    if any(isinstance(part, Clustered) for part in program.parts):
        return ""
    count = len(program.moved(scene))
    if count > MAX_MOVED:
        return f"expected at most {MAX_MOVED} blocks that {program!r} is about, found {count}"
    if count == len(scene.blocks):
        return f"expected a block that {program!r} is not about, found none"
    return ""


def _sample_demo(family: Family, program: Goal, rng: np.random.Generator) -> Scene | None:
    """A Demo scene for a program, enclosed blocks last; `None` if none of `MAX_SCENES` fits."""
    regions, nowhere = sample_count(*family.regions, rng), Pose(0.0, 0.0, 0.0)
    enclosed = regions if family.encloses else 0
    blocks = max(2, sample_count(*family.outside, rng) + enclosed)
    outline = Scene(
        nowhere,
        tuple(Block(SHAPES[0], COLOURS[0], nowhere) for _ in range(blocks)),
        tuple(Region(COLOURS[0], 0.0, 0.0, 0.5, 0.5) for _ in range(regions)),
    )
    for _ in range(MAX_SCENES):
        scene = randomise(outline, Axis.COLOUR | Axis.SHAPE, rng, enclosed, blocks)
        with suppress(PlacementError):
            scene = sample_placement(scene, Axis.LAYOUT, rng, _placement(family))
            if _has_room_for_all_shapes(scene) and not misfit(scene, program):
                return scene
    return None


def _has_room_for_all_shapes(scene: Scene) -> bool:
    """Whether the blocks fit whatever their shapes, since TestShape keeps Demo's poses."""
    places = [block.pose[:2] for block in scene.blocks]
    if any(math.dist(a, b) < 2 * STAR_OUTER_RADIUS for a, b in combinations(places, 2)):
        return False
    if any(abs(x) > WORKSPACE_HALF - STAR_OUTER_RADIUS for place in places for x in place):
        return False
    robot = Solid.of_robot(scene.robot)
    shaped = (Solid.of_block(replace(b, shape=shape)) for b in scene.blocks for shape in SHAPES)
    return not any(map(robot.overlaps, shaped))
