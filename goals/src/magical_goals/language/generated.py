"""Generated tasks: a number determines a program, a Demo scene and all variants.

The tasks are called Generated0000 to Generated9999. A program is sampled from one of several
families of goals (`DISTRIBUTION`), which also say what its scenes contain. What a number determines
changes only with `GENERATOR`, which corresponds to the version in the ids of their environments.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations

import numpy as np

from magical.errors import InvalidProgramError, PlacementError
from magical.physics.overlap import Solids
from magical.scene import COLOURS, SHAPES, Block, Pose, Region, Scene
from magical.scene.constants import STAR_OUTER_RADIUS, WORKSPACE_HALF
from magical.tasks import Task, TaskFamily
from magical.tasks.axes import (
    EVERYTHING,
    Axis,
    cycle_blocks,
    sample_attributes,
    sample_count,
    sample_item,
)
from magical.tasks.placement import Placement, sample_placement
from magical_goals.language import expressions as e
from magical_goals.language import goals as g
from magical_goals.language.expressions import Attribute, Corner, Landmark, Selection, Wall
from magical_goals.language.goals import Goal, problem

Rng = np.random.Generator

GENERATOR = 0  # the version of everything that a number's task depends on
MAX_PROGRAMS = 100  # sampled at most for one number
MAX_SCENES = 200  # sampled at most for one program
MAX_MOVED = 3  # blocks that a goal may be about at most, except for clusters
OUTSIDE = (2, 5)  # blocks outside the regions: minimum and maximum in Demo
CLUSTERED = (4, 6)  # blocks to be clustered: minimum and maximum in Demo
LINED = (3, 4)  # blocks, some of which must form a line: minimum and maximum in Demo
MORE_OUTSIDE = 2  # blocks outside the regions that CountPlus may add to the family's maximum
REGION_SIZE = (0.45, 0.7)  # units
MARGIN = 0.12  # units from an enclosed block's centre to its region's nearest edge
SHORT_HORIZON, HORIZON, LONG_HORIZON = 120, 180, 320  # control steps

# The suite: the first numbers with a new program and a task that the scripted expert solves
# (studies/generated_tasks). Every third one is held out; the others are to develop learners on.
# fmt: off
SUITE = (
    1, 2, 4, 5, 6, 7, 8, 9, 11, 12, 13, 16, 17, 20, 21, 22, 24, 25, 29, 30, 32, 33, 35, 37, 38,
    41, 42, 43, 46, 47, 49, 50, 51, 52, 53, 54, 56, 58, 61, 63, 65, 66, 67, 69, 72, 74, 81, 83,
    84, 85, 87, 90, 92, 94, 107, 108, 111, 112, 115, 117, 119, 120, 121, 123, 128, 129, 138,
    140, 142, 147, 149, 151, 152, 154, 156, 160, 162, 165, 166, 167, 169, 170, 171, 180, 182,
    183, 184, 185, 187, 188, 190, 199, 204, 205, 207, 211,
)
# fmt: on


def task_name(number: int) -> str:
    """The name of a generated task."""
    return f"Generated{number:04d}"


HELD_OUT = tuple(map(task_name, SUITE[2::3]))
TRAINING = tuple(name for name in map(task_name, SUITE) if name not in HELD_OUT)


@dataclass(frozen=True, slots=True)
class Goals:
    """Goals of one form: how often they are sampled, and what their scenes contain."""

    weight: float  # relative to the weights of the others
    sample_fn: Callable[[Rng], Goal]
    regions: tuple[int, int] = (0, 0)  # minimum and maximum number
    encloses: bool = False  # whether a block starts inside each region
    outside: tuple[int, int] = OUTSIDE  # minimum and maximum number of blocks outside the regions
    horizon: int = HORIZON  # control steps

    @property
    def placement(self) -> Placement:
        """How regions and blocks are placed."""
        return Placement(region_size=REGION_SIZE, encloses=self.encloses, margin=MARGIN)


def _landmark(rng: Rng) -> Goal:
    place: e.Place = (
        e.InCorner(sample_item(tuple(Corner), rng))
        if rng.random() < 0.5
        else e.AtWall(sample_item(tuple(Wall), rng))
    )
    return g.Each(sample_selection(rng, region=False), place)


def _beside(rng: Rng) -> Goal:
    other = sample_single(rng, region=False)
    return g.Each(e.And(sample_selection(rng, region=False), e.AllBut(other)), e.Beside(other))


def _out(rng: Rng) -> Goal:
    return g.Every(e.And(e.Enclosed(), sample_selection(rng, region=False)), e.OutOfRegions())


def _fix(rng: Rng) -> Goal:
    return g.Together(g.Every(e.Mismatched(), e.OutOfRegions()), g.Undisturbed(e.Matched()))


def _like(rng: Rng) -> Goal:
    kind = e.LikeEnclosed(sample_item(tuple(Attribute), rng))
    found: Goal = g.OneOf(e.And(e.Outside(), kind), e.InRegion())
    if rng.random() < 0.5:
        found = g.Each(e.And(e.Outside(), kind), e.InRegion())
    return g.Together(found, g.Together(g.Every(e.Enclosed(), e.InRegion()), g.Only(kind)))


def _swap(rng: Rng) -> Goal:
    chosen = e.And(e.Outside(), sample_selection(rng))
    out = g.Every(e.Enclosed(), e.OutOfRegions())
    return g.Together(out, g.Each(chosen, e.InRegion()))


# The distribution of programs: families of goals with their weights and scenes.
DISTRIBUTION: Mapping[str, Goals] = {
    "into": Goals(3, lambda rng: g.Each(sample_selection(rng), e.InRegion()), regions=(1, 1)),
    "exactly": Goals(2, lambda rng: g.Exactly(sample_selection(rng)), regions=(1, 1)),
    "own colour": Goals(1, lambda rng: g.Each(e.OfRegionColour(), e.InOwnColour()), regions=(2, 2)),
    "landmark": Goals(3, _landmark),
    "beside": Goals(2, _beside),
    "out": Goals(2, _out, regions=(2, 3), encloses=True, outside=(0, 1), horizon=SHORT_HORIZON),
    "fix": Goals(1, _fix, regions=(2, 3), encloses=True, outside=(0, 2), horizon=SHORT_HORIZON),
    "like": Goals(3, _like, regions=(1, 1), encloses=True),
    "swap": Goals(2, _swap, regions=(1, 1), encloses=True),
    "line": Goals(1, lambda rng: g.Lined(e.AllBut(sample_single(rng, False))), outside=LINED),
    "clusters": Goals(
        1, lambda rng: g.Clustered(_visible(rng)), outside=CLUSTERED, horizon=LONG_HORIZON
    ),
}


def sample_program(rng: Rng) -> tuple[Goals, Goal]:
    """Sample a family in proportion to its weight, and a program from it."""
    families = tuple(DISTRIBUTION.values())
    weights = np.array([family.weight for family in families])
    family = families[int(rng.choice(len(families), p=weights / weights.sum()))]
    return family, family.sample_fn(rng)


def sample_selection(rng: Rng, region: bool = True) -> Selection:
    """Sample a selection of one or several blocks; `region` admits those that need a region."""
    kinds: list[Callable[[], Selection]] = [
        lambda: e.WithColour(sample_item(COLOURS, rng)),
        lambda: e.WithShape(sample_item(SHAPES, rng)),
        lambda: e.MostCommon(_visible(rng)),
        lambda: sample_single(rng, region),
        lambda: e.AllBut(sample_single(rng, region)),
    ]
    if region:
        kinds.append(e.OfRegionColour)
    return sample_item(kinds, rng)()


def sample_single(rng: Rng, region: bool = True) -> Selection:
    """Sample a selection that means a single block."""
    landmarks = tuple(Landmark) if region else (Landmark.ROBOT, Landmark.CENTRE)
    kinds: list[Callable[[], Selection]] = [
        lambda: e.OddOneOut(_visible(rng)),
        lambda: e.Nearest(sample_item(landmarks, rng)),
        lambda: e.Farthest(sample_item(landmarks, rng)),
    ]
    return sample_item(kinds, rng)()


def _visible(rng: Rng) -> Attribute:
    return sample_item((Attribute.COLOUR, Attribute.SHAPE), rng)


@cache
def generate(name: str) -> tuple[Task, Goal]:
    """The task with a name such as Generated0042, and its program."""
    rng = np.random.default_rng([GENERATOR, int(name.removeprefix("Generated"))])
    for _ in range(MAX_PROGRAMS):
        family, program = sample_program(rng)
        if (demo := _sample_demo(family, program, rng)) is not None:
            task = _make_task(name, family, program, demo)
            with suppress(PlacementError):  # the program may rule out a variant
                for variant in task.variants:
                    task.sample(variant, rng)
                return task, program
    raise InvalidProgramError(f"{name}: found no scene for any of {MAX_PROGRAMS} programs")


SUITES = {"Held-out tasks": HELD_OUT, "Training tasks": TRAINING}
FAMILY = TaskFamily(lambda name: generate(name)[0], SUITES)


def _make_task(name: str, family: Goals, program: Goal, demo: Scene) -> Task:
    enclosed = len(demo.regions) if family.encloses else 0
    most = family.outside[1] + MORE_OUTSIDE
    return Task(
        name=name,
        summary=repr(program),
        horizon=family.horizon,
        demo=demo,
        axes=EVERYTHING,
        randomise_fn=partial(randomise, enclosed=enclosed, most=most),
        placement=family.placement,
        score_fn=program.score,
        instruction_fn=program.instruction,
        max_blocks=most + enclosed,
        max_regions=len(demo.regions),
        validate_fn=partial(misfit, program=program),
    )


def randomise(scene: Scene, axes: Axis, rng: Rng, enclosed: int, most: int) -> Scene:
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
    if any(isinstance(part, g.Clustered) for part in program.parts):
        return ""
    count = len(program.moved(scene))
    if count > MAX_MOVED:
        return f"expected at most {MAX_MOVED} blocks that {program!r} is about, found {count}"
    if count == len(scene.blocks):
        return f"expected a block that {program!r} is not about, found none"
    return ""


def _sample_demo(family: Goals, program: Goal, rng: Rng) -> Scene | None:
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
            scene = sample_placement(scene, Axis.LAYOUT, rng, family.placement)
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
    solids = Solids.cleared()
    robot = solids.take(None)
    robot.move(scene.robot)
    solids.place(robot)
    for block in scene.blocks:
        for shape in SHAPES:
            solid = solids.take(shape)
            solid.move(block.pose)
            if any(solids.overlaps(solid)):
                return False
    return True
