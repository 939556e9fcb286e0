"""Random programs: families of goals, with their weights and the contents of their scenes.

`DISTRIBUTION` is the whole distribution of programs.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from magical.scene import COLOURS, SHAPES
from magical.tasks.attributes import sample_item
from magical.tasks.programs import (
    AllBut,
    And,
    Attribute,
    AtWall,
    Beside,
    Clustered,
    Corner,
    Each,
    Enclosed,
    Every,
    Exactly,
    Farthest,
    Goal,
    InCorner,
    InOwnColour,
    InRegion,
    Landmark,
    LikeEnclosed,
    Lined,
    Matched,
    Mismatched,
    MostCommon,
    Nearest,
    OddOneOut,
    OfRegionColour,
    OneOf,
    Only,
    OutOfRegions,
    Outside,
    Place,
    Selection,
    Together,
    Undisturbed,
    Wall,
    WithColour,
    WithShape,
)

Rng = np.random.Generator

OUTSIDE = (2, 5)  # blocks outside the regions: minimum and maximum in Demo
CLUSTERED = (4, 6)  # blocks to be clustered: minimum and maximum in Demo
LINED = (3, 4)  # blocks, some of which must form a line: minimum and maximum in Demo
SHORT_HORIZON, HORIZON, LONG_HORIZON = 120, 180, 320  # control steps


@dataclass(frozen=True, slots=True)
class Family:
    """Goals of one form: how often they are sampled, and what their scenes contain.

    Attributes:
        weight: relative to the weights of the other families.
        sample_fn: samples a goal.
        regions: minimum and maximum number in its scenes.
        encloses: whether a block starts inside each region.
        outside: minimum and maximum number of blocks that start outside the regions.
        horizon: control steps.
    """

    weight: float
    sample_fn: Callable[[Rng], Goal]
    regions: tuple[int, int] = (0, 0)
    encloses: bool = False
    outside: tuple[int, int] = OUTSIDE
    horizon: int = HORIZON


def _landmark(rng: Rng) -> Goal:
    place: Place = (
        InCorner(sample_item(tuple(Corner), rng))
        if rng.random() < 0.5
        else AtWall(sample_item(tuple(Wall), rng))
    )
    return Each(sample_selection(rng, region=False), place)


def _beside(rng: Rng) -> Goal:
    other = sample_single(rng, region=False)
    return Each(And(sample_selection(rng, region=False), AllBut(other)), Beside(other))


def _out(rng: Rng) -> Goal:
    return Every(And(Enclosed(), sample_selection(rng, region=False)), OutOfRegions())


def _fix(rng: Rng) -> Goal:
    return Together(Every(Mismatched(), OutOfRegions()), Undisturbed(Matched()))


def _like(rng: Rng) -> Goal:
    kind = LikeEnclosed(sample_item(tuple(Attribute), rng))
    found: Goal = OneOf(And(Outside(), kind), InRegion())
    if rng.random() < 0.5:
        found = Each(And(Outside(), kind), InRegion())
    return Together(found, Together(Every(Enclosed(), InRegion()), Only(kind)))


def _swap(rng: Rng) -> Goal:
    chosen = And(Outside(), sample_selection(rng))
    return Together(Every(Enclosed(), OutOfRegions()), Each(chosen, InRegion()))


def _cluster(rng: Rng) -> Goal:
    return Clustered(sample_item((Attribute.COLOUR, Attribute.SHAPE), rng))


# The distribution of programs: families with their weights and scenes.
DISTRIBUTION: Mapping[str, Family] = {
    "into": Family(3, lambda rng: Each(sample_selection(rng), InRegion()), regions=(1, 1)),
    "exactly": Family(2, lambda rng: Exactly(sample_selection(rng)), regions=(1, 1)),
    "own colour": Family(1, lambda rng: Each(OfRegionColour(), InOwnColour()), regions=(2, 2)),
    "landmark": Family(3, _landmark),
    "beside": Family(2, _beside),
    "out": Family(2, _out, regions=(2, 3), encloses=True, outside=(0, 1), horizon=SHORT_HORIZON),
    "fix": Family(1, _fix, regions=(2, 3), encloses=True, outside=(0, 2), horizon=SHORT_HORIZON),
    "like": Family(3, _like, regions=(1, 1), encloses=True),
    "swap": Family(2, _swap, regions=(1, 1), encloses=True),
    "line": Family(1, lambda rng: Lined(AllBut(sample_single(rng, region=False))), outside=LINED),
    "clusters": Family(1, _cluster, outside=CLUSTERED, horizon=LONG_HORIZON),
}


def sample_program(rng: Rng) -> tuple[Family, Goal]:
    """Sample a family in proportion to its weight, and a program from it."""
    families = tuple(DISTRIBUTION.values())
    weights = np.array([family.weight for family in families])
    family = families[int(rng.choice(len(families), p=weights / weights.sum()))]
    return family, family.sample_fn(rng)


def sample_selection(rng: Rng, region: bool = True) -> Selection:
    """Sample a selection of one or several blocks; `region` admits those that need a region."""
    kinds: list[Callable[[], Selection]] = [
        lambda: WithColour(sample_item(COLOURS, rng)),
        lambda: WithShape(sample_item(SHAPES, rng)),
        lambda: MostCommon(sample_item((Attribute.COLOUR, Attribute.SHAPE), rng)),
        lambda: sample_single(rng, region),
        lambda: AllBut(sample_single(rng, region)),
    ]
    if region:
        kinds.append(OfRegionColour)
    return sample_item(kinds, rng)()


def sample_single(rng: Rng, region: bool = True) -> Selection:
    """Sample a selection that means a single block."""
    landmarks = tuple(Landmark) if region else (Landmark.ROBOT, Landmark.CENTRE)
    kinds: list[Callable[[], Selection]] = [
        lambda: OddOneOut(sample_item((Attribute.COLOUR, Attribute.SHAPE), rng)),
        lambda: Nearest(sample_item(landmarks, rng)),
        lambda: Farthest(sample_item(landmarks, rng)),
    ]
    return sample_item(kinds, rng)()
