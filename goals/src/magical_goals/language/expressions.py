"""Expressions of the language of goals: which blocks are meant, and where they should be.

An expression is a frozen dataclass of expressions, or words such as a colour, checked when it is
created. Its `repr` is its text, which `magical_goals.language.parse` reads. A selection is
determined by the scene that an episode starts from, so it does not change while blocks are moved.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from magical.errors import InvalidProgramError, UnknownNameError
from magical.messages import quoted
from magical.scene import Block, Colour, Point, Region, Scene, Shape, lengths, parse_word
from magical.scene.constants import WORKSPACE_HALF
from magical.tasks.move_to_corner import FULL_SCORE, NO_SCORE
from magical.tasks.scoring import NEIGHBOUR_DISTANCE


class Corner(StrEnum):
    """A corner of the workspace."""

    TOP_LEFT = "top left"
    TOP_RIGHT = "top right"
    BOTTOM_LEFT = "bottom left"
    BOTTOM_RIGHT = "bottom right"


class Wall(StrEnum):
    """A wall of the workspace."""

    LEFT = "left"
    RIGHT = "right"
    TOP = "top"
    BOTTOM = "bottom"


class Landmark(StrEnum):
    """What a block can be near to or far from."""

    REGION = "region"  # the nearest one
    ROBOT = "robot"  # where it starts
    CENTRE = "centre"  # of the workspace


Blocks = frozenset[int]  # indices of a scene's blocks
Floats = NDArray[np.float64]

CLEAR_DIFFERENCE = 0.1  # units by which the nearest or farthest block must differ from the next
WALL_ZONE = 0.3  # units from a wall to a block's centre that count as "at" it
CORNERS = {
    corner: ((1 if "right" in corner else -1), (1 if "top" in corner else -1)) for corner in Corner
}  # signs of x and y
NUMBERS = ("no", "the", "both", "the three", "the four", "the five", "the six")


class Attribute(StrEnum):
    """What blocks may have in common."""

    COLOUR = "colour"
    SHAPE = "shape"
    KIND = "kind"  # colour and shape

    @property
    def words(self) -> str:
        """The attribute in English."""
        return "colour and shape" if self is Attribute.KIND else str(self)


class Expression:
    """A typed expression; the types of its fields are classes.

    Raises:
        InvalidProgramError: a field has a wrong type; the message names the expression and field.
    """

    def __post_init__(self) -> None:
        for name, kind in field_types(type(self)).items():
            value = getattr(self, name)
            if issubclass(kind, StrEnum):
                try:
                    object.__setattr__(self, name, parse_word(kind, value))
                except UnknownNameError as error:
                    raise InvalidProgramError(f"{type(self).__name__}, {name}: {error}") from error
            elif not isinstance(value, kind):
                raise InvalidProgramError(
                    f"{type(self).__name__}, {name}: expected a {kind.__name__.lower()}, found "
                    f"{quoted(value)}"
                )

    @property
    def arguments(self) -> list[Any]:
        """The values of its fields, in order."""
        return [getattr(self, name) for name in field_types(type(self))]

    def __repr__(self) -> str:
        texts = (repr(str(v)) if isinstance(v, StrEnum) else repr(v) for v in self.arguments)
        return f"{type(self).__name__}({', '.join(texts)})"

    @property
    def parts(self) -> Iterator["Expression"]:
        """The expression itself and all expressions within it."""
        yield self
        for value in self.arguments:
            if isinstance(value, Expression):
                yield from value.parts


def field_types(kind: Any) -> Mapping[str, Any]:
    """The fields of a class of expressions, with their types."""
    return {field.name: field.type for field in fields(kind)}


@dataclass(frozen=True, repr=False)
class Selection(Expression):
    """Some of a scene's blocks."""

    single: ClassVar[bool] = False  # whether it means a single block
    template: ClassVar[str] = ""  # its clause, with its fields as `{0.field}`

    def blocks(self, scene: Scene) -> Blocks:
        """Indices of the selected blocks."""
        raise NotImplementedError

    @property
    def clause(self) -> str:
        """What follows "block" in English, such as "nearest to the region"."""
        return self.template.format(self)

    @property
    def phrase(self) -> str:
        """The selection in English without any block's colour and shape."""
        return f"{'the' if self.single else 'every'} block {self.clause}"


class AllBlocks(Selection):
    """All blocks."""

    template = "of all"

    def blocks(self, scene: Scene) -> Blocks:
        return frozenset(range(len(scene.blocks)))

    @property
    def phrase(self) -> str:
        return "all blocks"


@dataclass(frozen=True, repr=False)
class WithColour(Selection):
    """The blocks of a colour."""

    template = "that is {0.colour}"

    colour: Colour

    def blocks(self, scene: Scene) -> Blocks:
        return _where(block.colour == self.colour for block in scene.blocks)


@dataclass(frozen=True, repr=False)
class WithShape(Selection):
    """The blocks of a shape."""

    template = "that is a {0.shape}"

    shape: Shape

    def blocks(self, scene: Scene) -> Blocks:
        return _where(block.shape == self.shape for block in scene.blocks)


class OfRegionColour(Selection):
    """The blocks of the colour of any region."""

    template = "of the region's colour"

    def blocks(self, scene: Scene) -> Blocks:
        colours = {region.colour for region in scene.regions}
        return _where(block.colour in colours for block in scene.blocks)


class Enclosed(Selection):
    """The blocks that start inside a region."""

    template = "that is inside a region"

    def blocks(self, scene: Scene) -> Blocks:
        return _where(region_of(block, scene) is not None for block in scene.blocks)


class Outside(Selection):
    """The blocks that start outside all regions."""

    template = "that is outside"

    def blocks(self, scene: Scene) -> Blocks:
        return AllBlocks().blocks(scene) - Enclosed().blocks(scene)


class Mismatched(Selection):
    """The blocks that start inside a region of another colour."""

    template = "that is inside a region of another colour"

    def blocks(self, scene: Scene) -> Blocks:
        pairs = ((block, region_of(block, scene)) for block in scene.blocks)
        return _where(region is not None and region.colour != b.colour for b, region in pairs)


class Matched(Selection):
    """The blocks that start inside a region of their own colour."""

    template = "that is inside a region of its own colour"

    def blocks(self, scene: Scene) -> Blocks:
        return Enclosed().blocks(scene) - Mismatched().blocks(scene)


@dataclass(frozen=True, repr=False)
class _ByAttribute(Selection):
    attribute: Attribute

    def values(self, scene: Scene) -> list[str]:
        return [value_of(block, self.attribute) for block in scene.blocks]


class LikeEnclosed(_ByAttribute):
    """The blocks that have an attribute in common with a block that starts inside a region.

    That block is also selected; `And(Outside(), LikeEnclosed(...))` selects only those outside.
    """

    def blocks(self, scene: Scene) -> Blocks:
        values = self.values(scene)
        wanted = {values[i] for i in Enclosed().blocks(scene)}
        return _where(value in wanted for value in values)

    @property
    def clause(self) -> str:
        if self.attribute == Attribute.KIND:
            return "that looks like one inside a region"
        return f"that has the {self.attribute} of one inside a region"


class OddOneOut(_ByAttribute):
    """The block whose value of an attribute no other has, if there is exactly one such block."""

    single = True
    template = "whose {0.attribute.words} no other block has"

    def blocks(self, scene: Scene) -> Blocks:
        values = self.values(scene)
        alone = _where(values.count(value) == 1 for value in values)
        return alone if len(alone) == 1 else frozenset()


class MostCommon(_ByAttribute):
    """The blocks with the most common value of an attribute, if there is no tie."""

    template = "of the most common {0.attribute.words}"

    def blocks(self, scene: Scene) -> Blocks:
        values = self.values(scene)
        counts = Counter(values).most_common(2)
        if not counts or (len(counts) == 2 and counts[0][1] == counts[1][1]):
            return frozenset()
        return _where(value == counts[0][0] for value in values)


@dataclass(frozen=True, repr=False)
class _ByDistance(Selection):
    single = True
    sign: ClassVar[float] = 1.0
    landmark: Landmark

    def blocks(self, scene: Scene) -> Blocks:
        return _first([self.sign * each for each in distances_to(self.landmark, scene)])


class Nearest(_ByDistance):
    """The block nearest to a landmark, if it is nearest by `CLEAR_DIFFERENCE`."""

    template = "nearest to the {0.landmark}"


class Farthest(_ByDistance):
    """The block farthest from a landmark, if it is farthest by `CLEAR_DIFFERENCE`."""

    template = "farthest from the {0.landmark}"
    sign = -1.0


@dataclass(frozen=True, repr=False)
class AllBut(Selection):
    """All blocks except those in a selection."""

    selection: Selection

    def blocks(self, scene: Scene) -> Blocks:
        return AllBlocks().blocks(scene) - self.selection.blocks(scene)

    @property
    def clause(self) -> str:
        return f"but {self.selection.phrase.replace('every block', 'any')}"


@dataclass(frozen=True, repr=False)
class _Both(Selection):
    first: Selection
    second: Selection


class And(_Both):
    """The blocks in both selections."""

    def blocks(self, scene: Scene) -> Blocks:
        return self.first.blocks(scene) & self.second.blocks(scene)

    @property
    def clause(self) -> str:
        link = " " if isinstance(self.second, AllBut) else " and "
        return f"{self.first.clause}{link}{self.second.clause}"


class Or(_Both):
    """The blocks in either selection."""

    def blocks(self, scene: Scene) -> Blocks:
        return self.first.blocks(scene) | self.second.blocks(scene)

    @property
    def clause(self) -> str:
        return f"{self.first.clause} or {self.second.clause}"


@dataclass(frozen=True, repr=False)
class Place(Expression):
    """Where a block may be. `points` are the centres of all N blocks, in units."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        """How well a block is placed, from 0 to 1 (there)."""
        return float(self.remaining(scene, np.array(points))[block] <= 0.0)

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        """Distances (..., N) that blocks at points (..., N, 2) must still move, 0.0 once there."""
        raise NotImplementedError

    def phrase(self, scene: Scene) -> str:
        """The place in English after a verb of motion."""
        raise NotImplementedError


class InRegion(Place):
    """Inside any region."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return float(any(region.contains(*points[block]) for region in scene.regions))

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        nearest: Floats = distances_to_regions(scene, points).min(axis=-1, initial=np.inf)
        return nearest

    def phrase(self, scene: Scene) -> str:
        return f"into {name_regions(scene)}"


class InOwnColour(Place):
    """Inside a region of the block's own colour."""

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        colours = np.array([region.colour for region in scene.regions])
        others = np.array([block.colour for block in scene.blocks])[:, None] != colours  # (N, R)
        distances = np.where(others, np.inf, distances_to_regions(scene, points))
        nearest: Floats = distances.min(axis=-1, initial=np.inf)
        return nearest

    def phrase(self, scene: Scene) -> str:
        return "into the region of its colour"


class OutOfRegions(Place):
    """Outside all regions."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return float(not any(region.contains(*points[block]) for region in scene.regions))

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        deepest: Floats = depths_in_regions(scene, points).max(axis=-1, initial=0.0)
        return deepest

    def phrase(self, scene: Scene) -> str:
        return f"out of {name_regions(scene, 'any')}"


@dataclass(frozen=True, repr=False)
class InCorner(Place):
    """In a corner of the workspace, graded by distance (appendix A.2.1)."""

    corner: Corner

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        left = NO_SCORE - math.dist(points[block], self._point)
        return min(max(left / (NO_SCORE - FULL_SCORE), 0.0), 1.0)

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        return (lengths(points - self._point) - FULL_SCORE).clip(min=0.0)

    @property
    def _point(self) -> Point:
        x, y = CORNERS[self.corner]
        return x * WORKSPACE_HALF, y * WORKSPACE_HALF

    def phrase(self, scene: Scene) -> str:
        return f"to the {self.corner} corner"


@dataclass(frozen=True, repr=False)
class AtWall(Place):
    """At a wall of the workspace."""

    wall: Wall

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        x, y = points[..., 0], points[..., 1]
        along = {Wall.LEFT: -x, Wall.RIGHT: x, Wall.BOTTOM: -y, Wall.TOP: y}[self.wall]
        left: Floats = (WORKSPACE_HALF - WALL_ZONE - along).clip(min=0.0)
        return left

    def phrase(self, scene: Scene) -> str:
        return f"to the {self.wall} wall"


@dataclass(frozen=True, repr=False)
class Beside(Place):
    """At most `NEIGHBOUR_DISTANCE` from another block in a selection."""

    selection: Selection

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        chosen = np.array(sorted(self.selection.blocks(scene)), np.intp)
        away = lengths(points[..., :, None, :] - points[..., None, chosen, :])
        away[..., chosen, np.arange(len(chosen))] = np.inf  # no block is next to itself
        left: Floats = away.min(axis=-1, initial=np.inf) - NEIGHBOUR_DISTANCE
        return left.clip(min=0.0)

    def phrase(self, scene: Scene) -> str:
        return f"next to {describe(self.selection, scene)}"


def value_of(block: Block, attribute: Attribute) -> str:
    """A block's value of an attribute."""
    kind = f"{block.colour} {block.shape}"
    return kind if attribute is Attribute.KIND else str(getattr(block, attribute))


def region_of(block: Block, scene: Scene) -> Region | None:
    """The region that a block starts inside, if any."""
    x, y, _ = block.pose
    return next((region for region in scene.regions if region.contains(x, y)), None)


def distances_to(landmark: Landmark, scene: Scene) -> list[float]:
    """Each block's distance to a landmark at the start, in units; infinite if there is none."""
    points = {
        Landmark.ROBOT: [scene.robot[:2]],
        Landmark.CENTRE: [(0.0, 0.0)],
        Landmark.REGION: [region.centre for region in scene.regions],
    }[landmark]
    return [
        min((math.dist(block.pose[:2], point) for point in points), default=math.inf)
        for block in scene.blocks
    ]


def _where(flags: Iterable[bool]) -> Blocks:
    return frozenset(i for i, flag in enumerate(flags) if flag)


def _first(keys: list[float]) -> Blocks:
    """The index of the smallest key, if it is the smallest by `CLEAR_DIFFERENCE`."""
    order = sorted(range(len(keys)), key=keys.__getitem__)
    if not order or not math.isfinite(keys[order[0]]):
        return frozenset()
    if len(order) > 1 and keys[order[1]] - keys[order[0]] < CLEAR_DIFFERENCE:
        return frozenset()
    return frozenset(order[:1])


def depths_in_regions(scene: Scene, points: Floats) -> Floats:
    """Distances (..., R) of points (..., 2) from each region's nearest edge, negative outside."""
    x, y = points[..., 0, None], points[..., 1, None]
    left, top, width, height = _rectangles(scene)
    across = np.minimum(x - left, left + width - x)
    depths: Floats = np.minimum(across, np.minimum(top - y, y - (top - height)))
    return depths


def distances_to_regions(scene: Scene, points: Floats) -> Floats:
    """Distances (..., R) from points (..., 2) to each region, 0.0 inside."""
    x, y = points[..., 0, None], points[..., 1, None]
    left, top, width, height = _rectangles(scene)
    across = np.maximum(left - x, x - left - width).clip(min=0.0)
    down = np.maximum(top - height - y, y - top).clip(min=0.0)
    distances: Floats = np.hypot(across, down)
    return distances


def _rectangles(scene: Scene) -> Floats:
    """Left and top edges, widths and heights of the regions: (4, R)."""
    return np.array([(r.x, r.y, r.width, r.height) for r in scene.regions]).reshape(-1, 4).T


def describe(selection: Selection, scene: Scene) -> str:
    """A selection in English, such as "the red star and both blue circles".

    Blocks that colours and shapes do not distinguish are described by the relation that selects
    them, such as "the block nearest to the region".
    """
    chosen = selection.blocks(scene)
    if isinstance(selection, AllBlocks) and len(chosen) > 1:
        return selection.phrase
    *names, last = _names(chosen, scene) or [selection.phrase]
    return f"{', '.join(names)} and {last}" if names else last


def _names(chosen: Blocks, scene: Scene) -> list[str] | None:
    """Each kind of the chosen blocks, distinguished from all others; `None` if it cannot be."""
    kinds = [value_of(block, Attribute.KIND) for block in scene.blocks]
    enclosed = Enclosed().blocks(scene)
    names = []
    for kind, count in Counter(kinds[i] for i in sorted(chosen)).items():
        alike = {i for i, other in enumerate(kinds) if other == kind}
        where = _distinction(alike & chosen, alike - chosen, enclosed)
        if where is None or count >= len(NUMBERS):
            return None
        plural = "s" if count > 1 else ""
        names.append(f"{NUMBERS[count]} {kind}{plural}{where}")
    return names


def _distinction(chosen: set[int], others: set[int], enclosed: Blocks) -> str | None:
    """What distinguishes chosen blocks from others of their kind; `None` if nothing does."""
    if not others:
        return ""
    verb = "are" if len(chosen) > 1 else "is"
    if chosen <= enclosed and not others & enclosed:
        return f" that {verb} inside"
    if others <= enclosed and not chosen & enclosed:
        return f" that {verb} outside"
    return None


def name_regions(scene: Scene, article: str = "a") -> str:
    """The scene's regions in English: "the blue region", or `article` "region" if not just one."""
    only = len(scene.regions) == 1
    return f"the {scene.regions[0].colour} region" if only else f"{article} region"


def stay(what: str, blocks: Blocks) -> str:
    """Where blocks, described as `what`, should stay, in English."""
    return "where it is" if len(blocks) == 1 or what.startswith("every") else "where they are"
