"""Goals: what a final state is scored by, in the appendix's manner.

Every goal gives a score from 0 to 1, the units that blocks have still to go, and an English
instruction. Goals are combined by `Together`, whose score is the product.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise, product

import numpy as np

from magical.grouping import group_by
from magical.scene import Poses, Scene
from magical.scene.constants import BLOCK_SIZE, ROBOT_RADIUS
from magical.scene.geometry import Point, to_workspace
from magical.tasks.programs.expressions import Attribute, Expression
from magical.tasks.programs.places import InRegion, OutOfRegions, Place, depth_inside
from magical.tasks.programs.selections import AllBlocks, AllBut, Blocks, Selection, value_of
from magical.tasks.programs.wording import Style, describe, name_regions, stay
from magical.tasks.scoring import (
    INLIER_DISTANCE,
    NEIGHBOUR_DISTANCE,
    Distances,
    centroid_distances,
    longest_line,
    positions,
)

SUCCESS = 0.5  # a final state is a success above this score: where every graded rule is past half
CLUSTER_NO_SCORE = 0.5  # fraction of blocks clustered up to which the score is 0 (appendix A.2.7)
UNFINISHED = 0.5  # what every block that must move costs in `progress`, in units
MOVE = ("Push", "Move", "Bring")  # one a paraphrase
KEEP = ("Keep", "Leave", "Hold")
ROBOT = None  # in place of a block's index

Remaining = Mapping[int | None, float]  # block or `ROBOT` -> units that it has still to go


@dataclass(frozen=True, repr=False)
class Goal(Expression):
    """What is to be so at the end of an episode."""

    def score(self, scene: Scene, poses: Poses) -> float:
        """The score, 0 to 1, of final poses in an episode that started from `scene`."""
        raise NotImplementedError

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        """The ways to reach the goal: the blocks that must still move, and how far each."""
        raise NotImplementedError

    def moved(self, scene: Scene) -> Blocks:
        """The blocks that the goal is about, by default none."""
        return frozenset()

    def sentence(self, scene: Scene, style: Style) -> str:
        """The goal as an English sentence; see `instruction`."""
        raise NotImplementedError


@dataclass(frozen=True, repr=False)
class _OfBlocks(Goal):
    selection: Selection

    def moved(self, scene: Scene) -> Blocks:
        return self.selection.blocks(scene)


@dataclass(frozen=True, repr=False)
class _Placed(_OfBlocks):
    """Blocks of a selection at a place."""

    place: Place

    def degrees(self, scene: Scene, poses: Poses) -> list[float]:
        """How well each selected block is placed, 0 to 1."""
        points = positions(scene, poses)
        chosen = sorted(self.selection.blocks(scene))
        return [self.place.degree(scene, block, points) for block in chosen]

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        points = positions(scene, poses)
        chosen = self.selection.blocks(scene)
        units = {block: self.place.remaining(scene, block, points) for block in chosen}
        return [{block: left for block, left in units.items() if left > 0.0}]

    def sentence(self, scene: Scene, style: Style) -> str:
        what = describe(self.selection, scene, style)
        if not all(self.ways(scene, Poses.at_rest(scene))):
            return f"{style.of(KEEP)} {what} {stay(what, self.moved(scene))}."
        return f"{style.of(MOVE)} {what} {self.place.phrase(scene, style)}."


class Each(_Placed):
    """Each selected block counts: the score is the mean of how well they are placed."""

    def score(self, scene: Scene, poses: Poses) -> float:
        degrees = self.degrees(scene, poses)
        return sum(degrees) / len(degrees) if degrees else 0.0


class Every(_Placed):
    """All selected blocks or nothing: 1 if all are there, otherwise 0."""

    def score(self, scene: Scene, poses: Poses) -> float:
        degrees = self.degrees(scene, poses)
        return float(bool(degrees) and min(degrees) >= 1.0)


class OneOf(_Placed):
    """Any one of the selected blocks: 1 if at least one is there, otherwise 0."""

    def score(self, scene: Scene, poses: Poses) -> float:
        return float(max(self.degrees(scene, poses), default=0.0) >= 1.0)

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        (remaining,) = super().ways(scene, poses)
        if self.score(scene, poses) == 1.0:
            return [{}]
        return [{block: left} for block, left in remaining.items()] or [{}]

    def sentence(self, scene: Scene, style: Style) -> str:
        chosen = self.selection.blocks(scene)
        if len(chosen) == 1 and style.attributes:
            return super().sentence(scene, style)
        kinds = {value_of(scene.blocks[i], Attribute.KIND) for i in chosen}
        what = self.selection.phrase.replace("every block", "a block")
        if style.attributes and len(kinds) == 1:
            what = f"one {kinds.pop()}"
        return f"{style.of(MOVE)} {what} {self.place.phrase(scene, style)}."


class Only(_OfBlocks):
    """No others in the regions: 1 less the share of other blocks among those in regions."""

    def score(self, scene: Scene, poses: Poses) -> float:
        points, chosen = positions(scene, poses), self.selection.blocks(scene)
        inside = {i for i in range(len(points)) if InRegion().degree(scene, i, points)}
        return 1.0 - len(inside - chosen) / len(inside) if inside else 1.0

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        return self.others.ways(scene, poses)

    def moved(self, scene: Scene) -> Blocks:
        return frozenset()

    def sentence(self, scene: Scene, style: Style) -> str:
        place = name_regions(scene, style, "any")
        return f"{style.of(KEEP)} all other blocks out of {place}."

    @cached_property
    def others(self) -> Each:
        """The goal that has the same ways: the other blocks at a place."""
        return Each(AllBut(self.selection), OutOfRegions())


class Exactly(_OfBlocks):
    """All of a selection and no others in the regions: the product of `Each` and `Only`."""

    def score(self, scene: Scene, poses: Poses) -> float:
        return self.both.score(scene, poses)

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        return self.both.ways(scene, poses)

    def sentence(self, scene: Scene, style: Style) -> str:
        return self.both.sentence(scene, style)

    @cached_property
    def both(self) -> "Together":
        """The two goals that it stands for."""
        return Together(Each(self.selection, InRegion()), Only(self.selection))


class Undisturbed(_OfBlocks):
    """Every region in which a selected block starts has the same blocks at the end: 1, else 0."""

    def score(self, scene: Scene, poses: Poses) -> float:
        return float(all(before == after for before, after in self._contents(scene, poses)))

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        contents = self._contents(scene, poses)
        left = {block for before, after in contents for block in before - after}
        came = {block for before, after in contents for block in after - before}
        points = positions(scene, poses)
        units: dict[int | None, float] = {i: InRegion().remaining(scene, i, points) for i in left}
        return [{**units, **{i: depth_inside(scene, points[i]) for i in came}}]

    def moved(self, scene: Scene) -> Blocks:
        return frozenset()

    def sentence(self, scene: Scene, style: Style) -> str:
        what = describe(self.selection, scene, style)
        return f"{style.of(KEEP)} {what} {stay(what, self.selection.blocks(scene))}."

    def _contents(self, scene: Scene, poses: Poses) -> list[tuple[set[int], set[int]]]:
        """The blocks at the start and now in each region that the goal is about."""
        chosen, points = self.selection.blocks(scene), positions(scene, poses)
        starts = [block.pose[:2] for block in scene.blocks]
        both = [
            [{i for i, xy in enumerate(at) if region.contains(*xy)} for at in (starts, points)]
            for region in scene.regions
        ]
        return [(before, after) for before, after in both if before & chosen]


class Lined(_OfBlocks):
    """Selected blocks in one line: 1, for all but one 0.5, otherwise 0 (appendix A.2.4)."""

    def score(self, scene: Scene, poses: Poses) -> float:
        points = self._points(scene, poses)
        missing = len(points) - longest_line(points)
        return {0: 1.0, 1: 0.5}.get(missing, 0.0) if len(points) > 1 else 0.0

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        points, chosen = self._points(scene, poses), sorted(self.selection.blocks(scene))
        if len(points) < 2:
            return [{ROBOT: math.inf}]
        lines = [_units_to_line(i, j, points) for i, j in combinations(range(len(points)), 2)]
        return [
            {block: left for block, left in zip(chosen, units, strict=True) if left > 0.0}
            for units in lines
        ]

    def sentence(self, scene: Scene, style: Style) -> str:
        verb = style.of(("Arrange", "Put", "Place"))
        return f"{verb} {describe(self.selection, scene, style)} in a line."

    def _points(self, scene: Scene, poses: Poses) -> list[Point]:
        points = positions(scene, poses)
        return [points[i] for i in sorted(self.selection.blocks(scene))]


@dataclass(frozen=True, repr=False)
class Clustered(Goal):
    """All blocks in clusters by an attribute, as in ClusterColour (appendix A.2.7)."""

    attribute: Attribute

    def score(self, scene: Scene, poses: Poses) -> float:
        own, other = self.distances(scene, poses)
        fraction = float(np.mean(own < other / 3))
        return max(0.0, fraction - CLUSTER_NO_SCORE) / (1.0 - CLUSTER_NO_SCORE)

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        own, other = self.distances(scene, poses)
        if (own < other / 3).all():
            return [{}]
        points = positions(scene, poses)
        blocks = range(len(scene.blocks))
        kinds = group_by(blocks, lambda i: value_of(scene.blocks[i], self.attribute))
        gathered: dict[int | None, float] = {}
        for alike in kinds.values():
            ways: list[Remaining] = [_units_to_gather(centre, alike, points) for centre in alike]
            nearest: Remaining = min(ways, key=_total)
            gathered.update(nearest)
        too_far = np.sqrt(own) - np.sqrt(other / 3)
        for block in np.flatnonzero(too_far >= 0.0).tolist():
            gathered[block] = gathered.get(block, 0.0) + float(too_far[block])
        return [gathered]

    def moved(self, scene: Scene) -> Blocks:
        return AllBlocks().blocks(scene)

    def sentence(self, scene: Scene, style: Style) -> str:
        verb = style.of(("Push", "Move", "Sort"))
        return f"{verb} the blocks into clusters of the same {self.attribute.words}."

    def distances(self, scene: Scene, poses: Poses) -> tuple[Distances, Distances]:
        """See `centroid_distances`: of each block to its own value's centroid, to another's."""
        values = [value_of(block, self.attribute) for block in scene.blocks]
        return centroid_distances(values, positions(scene, poses))


class RobotInside(Goal):
    """The robot's centre inside a region: 1, otherwise 0 (appendix A.2.2)."""

    def score(self, scene: Scene, poses: Poses) -> float:
        x, y, _ = poses.robot
        return float(any(region.contains(x, y) for region in scene.regions))

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        way = InRegion().remaining(scene, 0, [poses.robot[:2]])
        return [{ROBOT: way} if way > 0.0 else {}]

    def sentence(self, scene: Scene, style: Style) -> str:
        verb = style.of(("Drive", "Go", "Move"))
        return f"{verb} {InRegion().phrase(scene, style)}."


@dataclass(frozen=True, repr=False)
class Together(Goal):
    """Both goals: the product of their scores."""

    first: Goal
    second: Goal

    def score(self, scene: Scene, poses: Poses) -> float:
        return self.first.score(scene, poses) * self.second.score(scene, poses)

    def ways(self, scene: Scene, poses: Poses) -> list[Remaining]:
        both = product(self.first.ways(scene, poses), self.second.ways(scene, poses))
        return [{**first, **second} for first, second in both]

    def moved(self, scene: Scene) -> Blocks:
        return self.first.moved(scene) | self.second.moved(scene)

    def sentence(self, scene: Scene, style: Style) -> str:
        first, second = (goal.sentence(scene, style) for goal in (self.first, self.second))
        return f"{first} {second}"


def _units_to_gather(centre: int, blocks: Sequence[int], points: list[Point]) -> Remaining:
    """Units that blocks have to go to be beside one of them, without those that are there."""
    units = {i: math.dist(points[i], points[centre]) - NEIGHBOUR_DISTANCE for i in blocks}
    return {i: left for i, left in units.items() if left > 0.0}


def _total(remaining: Remaining) -> float:
    return sum(UNFINISHED + left for left in remaining.values())


def _units_to_line(i: int, j: int, points: list[Point]) -> list[float]:
    """Units that each block has to go for a line through blocks i and j."""
    (x, y), length = points[i], math.dist(points[i], points[j]) or 1.0
    ux, uy = (points[j][0] - x) / length, (points[j][1] - y) / length
    units = [max(0.0, abs(ux * (py - y) - uy * (px - x)) - INLIER_DISTANCE) for px, py in points]
    order = sorted(range(len(points)), key=lambda k: ux * points[k][0] + uy * points[k][1])
    for a, b in pairwise(order):
        gap = ux * (points[b][0] - points[a][0]) + uy * (points[b][1] - points[a][1])
        units[b] += max(0.0, gap - NEIGHBOUR_DISTANCE)
    return units


def instruction(goal: Goal, scene: Scene, *, paraphrase: int = 0, attributes: bool = True) -> str:
    """A goal in a scene as an English instruction.

    Args:
        goal: what is to be done.
        scene: the initial scene.
        paraphrase: which wording; there are `len(MOVE)`, beyond which they repeat.
        attributes: whether blocks and regions are named by their colours and shapes, as in "Push
            the yellow pentagon that is outside into the yellow region."; otherwise only by what the
            task is about, as in "Push a block that is outside and looks like one inside ...".
    """
    return goal.sentence(scene, Style(paraphrase, attributes))


def progress(goal: Goal, scene: Scene, poses: Poses) -> float:
    """The potential whose increase is the dense reward, in units.

    With d_i the units that block i has still to go, and w those of the robot's way along the blocks
    that must move, from between its fingers to the nearest block and from each to the nearest left,

        progress = - sum over blocks that must move of (UNFINISHED + d_i)  -  w,

    the highest over all ways to reach the goal. It depends on the state alone, so that rewards sum
    to zero over a loop, and it falls neither where a block is finished and the next one is far nor
    where another way becomes better.
    """
    points = positions(scene, poses)
    between_fingers = to_workspace((0.0, ROBOT_RADIUS + BLOCK_SIZE), poses.robot)
    return -min(
        _total(remaining)
        + _way_along(between_fingers, [points[i] for i in remaining if i is not None])
        for remaining in goal.ways(scene, poses)
    )


def _way_along(start: Point, points: list[Point]) -> float:
    """Units from a point along all others, each time to the nearest one left."""
    length, left = 0.0, list(points)
    while left:
        nearest = min(left, key=lambda point: math.dist(point, start))
        length += math.dist(nearest, start)
        left.remove(nearest)
        start = nearest
    return length
