"""Selections: which blocks of an initial scene are meant.

A selection is determined by the scene that an episode starts from, so it does not change while
blocks are moved.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from magical.scene import Block, Colour, Region, Scene, Shape
from magical.scene.vocabulary import Landmark
from magical.tasks.programs.expressions import Attribute, Expression

Blocks = frozenset[int]  # indices of a scene's blocks
CLEAR_DIFFERENCE = 0.1  # units by which the nearest or farthest block must differ from the next


@dataclass(frozen=True, repr=False)
class Selection(Expression):
    """Some of a scene's blocks.

    Attributes:
        single: whether it means a single block.
        template: its clause, with its fields as `{0.field}`.
    """

    single: ClassVar[bool] = False
    template: ClassVar[str] = ""

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
        regions = [region_of(block, scene) for block in scene.blocks]
        return _where(
            region is not None and region.colour != block.colour
            for block, region in zip(scene.blocks, regions, strict=True)
        )


class Matched(Selection):
    """The blocks that start inside a region of their own colour."""

    template = "that is inside a region of its own colour"

    def blocks(self, scene: Scene) -> Blocks:
        return Enclosed().blocks(scene) - Mismatched().blocks(scene)


@dataclass(frozen=True, repr=False)
class _ByAttribute(Selection):
    attribute: Attribute


class LikeEnclosed(_ByAttribute):
    """The blocks that have an attribute in common with a block that starts inside a region.

    That block is also selected; `And(Outside(), LikeEnclosed(...))` selects only those outside.
    """

    def blocks(self, scene: Scene) -> Blocks:
        values = [value_of(block, self.attribute) for block in scene.blocks]
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
        values = [value_of(block, self.attribute) for block in scene.blocks]
        alone = _where(values.count(value) == 1 for value in values)
        return alone if len(alone) == 1 else frozenset()


class MostCommon(_ByAttribute):
    """The blocks with the most common value of an attribute, if there is no tie."""

    template = "of the most common {0.attribute.words}"

    def blocks(self, scene: Scene) -> Blocks:
        values = [value_of(block, self.attribute) for block in scene.blocks]
        counts = Counter(values).most_common(2)
        if not counts or (len(counts) == 2 and counts[0][1] == counts[1][1]):
            return frozenset()
        return _where(value == counts[0][0] for value in values)


@dataclass(frozen=True, repr=False)
class _ByDistance(Selection):
    single = True
    landmark: Landmark


class Nearest(_ByDistance):
    """The block nearest to a landmark, if it is nearest by `CLEAR_DIFFERENCE`."""

    template = "nearest to the {0.landmark}"

    def blocks(self, scene: Scene) -> Blocks:
        return _first(distances_to(self.landmark, scene))


class Farthest(_ByDistance):
    """The block farthest from a landmark, if it is farthest by `CLEAR_DIFFERENCE`."""

    template = "farthest from the {0.landmark}"

    def blocks(self, scene: Scene) -> Blocks:
        return _first([-distance for distance in distances_to(self.landmark, scene)])


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


def value_of(block: Block, attribute: Attribute) -> str:
    """A block's value of an attribute."""
    if attribute == Attribute.COLOUR:
        return block.colour
    if attribute == Attribute.SHAPE:
        return block.shape
    return f"{block.colour} {block.shape}"


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
