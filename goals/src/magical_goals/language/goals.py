"""Goals: how a final state is scored, in the manner of the appendix.

Every goal gives a score from 0 to 1, the distances that blocks still have to move, and an English
instruction. `Together` combines two goals; its score is their product.
"""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from magical.grouping import group_by
from magical.scene import FIRST_BLOCK, ROBOT, Point, Poses, Scene, lengths, to_workspace
from magical.scene.constants import BLOCK_SIZE, ROBOT_RADIUS
from magical.tasks.clustering import NO_SCORE
from magical.tasks.scoring import (
    INLIER_DISTANCE,
    NEIGHBOUR_DISTANCE,
    centroid_distances,
    longest_line,
    positions,
)
from magical_goals.language.expressions import (
    AllBlocks,
    AllBut,
    Attribute,
    Blocks,
    Expression,
    Floats,
    InRegion,
    OutOfRegions,
    Place,
    Selection,
    describe,
    distances_to_regions,
    name_regions,
    stay,
    value_of,
)

SUCCESS = 0.5  # a final state is a success above this score, halfway through every graded rule
UNFINISHED = 0.5  # fixed cost in `progress` of every block that must move, in units


class States:
    """P states of an episode: positions of the robot (P, 2) and of N blocks (P, N, 2)."""

    def __init__(self, scene: Scene, bodies: Floats) -> None:
        """Take poses (P, 5 + N, 3) as in `Poses.bodies`."""
        self.scene = scene
        self.robot, self.points = bodies[:, ROBOT, :2], bodies[:, FIRST_BLOCK:, :2]
        self._units: dict[Place, Floats] = {}
        self._parts: dict[Goal, Floats] = {}

    def units(self, place: Place) -> Floats:
        """Distances (P, N), in units, that blocks still have to move to a place; computed once."""
        if place not in self._units:
            self._units[place] = place.remaining(self.scene, self.points)
        return self._units[place]

    def ways_of_part(self, goal: "Goal") -> Floats:
        """A goal's ways, cached because several goals may share a part."""
        if goal not in self._parts:
            self._parts[goal] = goal.ways(self)
        return self._parts[goal]

    def work(self, goal: "Goal") -> Floats:
        """The least work, in units, that any way to reach a goal leaves: (P,)."""
        work: Floats = goal.ways(self).sum(axis=2).min(axis=1)
        return work

    def best_way(self, goal: "Goal") -> Floats:
        """The work that the best way leaves for each block and, last, the robot: (P, N + 1)."""
        ways = goal.ways(self)
        best: Floats = ways[np.arange(len(ways)), ways.sum(axis=2).argmin(axis=1)]
        return best


@dataclass(frozen=True, repr=False)
class Goal(Expression):
    """What should be true at the end of an episode."""

    def score(self, scene: Scene, poses: Poses) -> float:
        """The score, 0 to 1, of final poses in an episode that started from `scene`."""
        raise NotImplementedError

    def ways(self, states: States) -> Floats:
        """The W ways to reach the goal from each of P states: (P, W, N + 1).

        A way is the work left for each block and, last, for the robot: 0 once it is where it should
        be, otherwise `UNFINISHED` plus the distance that it still has to move, in units.
        """
        raise NotImplementedError

    def moved(self, scene: Scene) -> Blocks:
        """The blocks that the goal is about, by default none."""
        return frozenset()

    def instruction(self, scene: Scene) -> str:
        """The goal in English, for an episode that starts from the scene."""
        raise NotImplementedError


@dataclass(frozen=True, repr=False)
class _OfBlocks(Goal):
    moves: ClassVar[bool] = True  # whether the goal is about the selected blocks
    selection: Selection

    def moved(self, scene: Scene) -> Blocks:
        return self.selection.blocks(scene) if self.moves else frozenset()


@dataclass(frozen=True, repr=False)
class _Placed(_OfBlocks):
    """Blocks of a selection at a place."""

    place: Place

    def degrees(self, scene: Scene, poses: Poses) -> list[float]:
        """How well each selected block is placed, 0 to 1."""
        points, chosen = positions(scene, poses), sorted(self.selection.blocks(scene))
        return [self.place.degree(scene, block, points) for block in chosen]

    def ways(self, states: States) -> Floats:
        chosen = sorted(self.selection.blocks(states.scene))
        units = states.units(self.place)[:, chosen]
        return _one_way(states, chosen, units, units > 0.0)

    def instruction(self, scene: Scene) -> str:
        what = describe(self.selection, scene)
        if not ways_at_start(self, scene).any(axis=1).all():
            return f"Keep {what} {stay(what, self.moved(scene))}."
        return f"Push {what} {self.place.phrase(scene)}."


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

    def ways(self, states: States) -> Floats:
        ways = super().ways(states)
        chosen = np.array(sorted(self.selection.blocks(states.scene)) or [-1])[:, None]
        ways = np.where(np.arange(ways.shape[-1]) == chosen, ways, 0.0)
        shortest = ways.sum(axis=2, keepdims=True).min(axis=1, keepdims=True)
        return np.where(shortest > 0.0, ways, 0.0)  # once one is there, nothing is left

    def instruction(self, scene: Scene) -> str:
        chosen = self.selection.blocks(scene)
        if len(chosen) == 1:
            return super().instruction(scene)
        kinds = {value_of(scene.blocks[i], Attribute.KIND) for i in chosen}
        what = re.sub("every block|all blocks", "a block", self.selection.phrase)
        if len(kinds) == 1:
            what = f"one {kinds.pop()}"
        return f"Push {what} {self.place.phrase(scene)}."


class Only(_OfBlocks):
    """No others in the regions: 1 minus the share of other blocks among those in regions."""

    moves = False

    def score(self, scene: Scene, poses: Poses) -> float:
        points, chosen = positions(scene, poses), self.selection.blocks(scene)
        inside = {i for i in range(len(points)) if InRegion().degree(scene, i, points)}
        return 1.0 - len(inside - chosen) / len(inside) if inside else 1.0

    def ways(self, states: States) -> Floats:
        return self.others.ways(states)

    def instruction(self, scene: Scene) -> str:
        return f"Keep all other blocks out of {name_regions(scene, 'any')}."

    @cached_property
    def others(self) -> Each:
        """The goal with the same ways: all other blocks out of the regions."""
        return Each(AllBut(self.selection), OutOfRegions())


class Exactly(_OfBlocks):
    """All selected blocks and no others in the regions: the product of `Each` and `Only`."""

    def score(self, scene: Scene, poses: Poses) -> float:
        return self.both.score(scene, poses)

    def ways(self, states: States) -> Floats:
        return self.both.ways(states)

    def instruction(self, scene: Scene) -> str:
        return self.both.instruction(scene)

    @cached_property
    def both(self) -> "Together":
        """The two goals that it combines."""
        return Together(Each(self.selection, InRegion()), Only(self.selection))


class Undisturbed(_OfBlocks):
    """1 if every region in which a selected block starts has the same blocks at the end, else 0."""

    moves = False

    def score(self, scene: Scene, poses: Poses) -> float:
        left, came = self._changes(scene, np.reshape(positions(scene, poses), (-1, 2)))
        return float(not (left | came).any())

    def ways(self, states: States) -> Floats:
        left, came = self._changes(states.scene, states.points)
        back = np.where(left, distances_to_regions(states.scene, states.points), 0.0)
        has_come, moves = (np.logical_or.reduce(each, axis=-1) for each in (came, left | came))
        units = np.where(has_come, states.units(OutOfRegions()), back.max(axis=-1, initial=0.0))
        return _one_way(states, slice(len(states.scene.blocks)), units, moves)

    def instruction(self, scene: Scene) -> str:
        what = describe(self.selection, scene)
        return f"Keep {what} {stay(what, self.selection.blocks(scene))}."

    def _changes(self, scene: Scene, points: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether blocks at points (..., N, 2) left each region, or entered it: (..., N, R) each.

        Only regions in which a selected block starts count.
        """
        starts = np.reshape([block.pose[:2] for block in scene.blocks], (-1, 2))
        before, after = (distances_to_regions(scene, at) <= 0.0 for at in (starts, points))
        about = before[sorted(self.selection.blocks(scene))].any(axis=0)  # (R,)
        return before & ~after & about, after & ~before & about


class Lined(_OfBlocks):
    """Selected blocks in a line: 1 if all are, 0.5 if all but one are, else 0 (appendix A.2.4)."""

    def score(self, scene: Scene, poses: Poses) -> float:
        points = positions(scene, poses)
        chosen = [points[i] for i in sorted(self.selection.blocks(scene))]
        missing = len(chosen) - longest_line(chosen)
        return {0: 1.0, 1: 0.5}.get(missing, 0.0) if len(chosen) > 1 else 0.0

    def ways(self, states: States) -> Floats:
        chosen = sorted(self.selection.blocks(states.scene))
        if len(chosen) < 2:
            never = np.full((len(states.points), 1), np.inf)
            return _one_way(states, [-1], never, never > 0.0)
        units = _units_to_lines(states.points[:, chosen])  # (P, W, K)
        ways = np.zeros((*units.shape[:2], len(states.scene.blocks) + 1))
        ways[..., chosen] = np.where(units > 0.0, UNFINISHED + units, 0.0)
        return ways

    def instruction(self, scene: Scene) -> str:
        return f"Arrange {describe(self.selection, scene)} in a line."


@dataclass(frozen=True, repr=False)
class Clustered(Goal):
    """All blocks in clusters by an attribute, as in ClusterColour (appendix A.2.7)."""

    attribute: Attribute

    def score(self, scene: Scene, poses: Poses) -> float:
        own, other = self.distances(scene, poses)
        fraction = float(np.mean(own < other / 3))
        return max(0.0, fraction - NO_SCORE) / (1.0 - NO_SCORE)

    def ways(self, states: States) -> Floats:
        scene, blocks = states.scene, range(len(states.scene.blocks))
        own, other = centroid_distances(self._values(scene), states.points)  # (P, N) each
        too_far = np.sqrt(own) - np.sqrt(other / 3)
        units = too_far.clip(min=0.0)
        unfinished = too_far >= 0.0
        for alike in group_by(blocks, self._values(scene).__getitem__).values():
            gather = _units_to_gather(states.points[:, alike])
            units[:, alike] += gather
            unfinished[:, alike] |= gather > 0.0
        unfinished &= (own >= other / 3).any(axis=1, keepdims=True)
        return _one_way(states, slice(len(blocks)), units, unfinished)

    def moved(self, scene: Scene) -> Blocks:
        return AllBlocks().blocks(scene)

    def instruction(self, scene: Scene) -> str:
        return f"Push the blocks into clusters of the same {self.attribute.words}."

    def distances(self, scene: Scene, poses: Poses) -> tuple[Floats, Floats]:
        """Squared distances of blocks to own and other centroids; see `centroid_distances`."""
        return centroid_distances(self._values(scene), np.array(positions(scene, poses)))

    def _values(self, scene: Scene) -> list[str]:
        return [value_of(block, self.attribute) for block in scene.blocks]


class RobotInside(Goal):
    """The robot in a region: 1 if its centre is inside one, otherwise 0 (appendix A.2.2)."""

    def score(self, scene: Scene, poses: Poses) -> float:
        return InRegion().degree(scene, 0, [poses.robot[:2]])

    def ways(self, states: States) -> Floats:
        units = InRegion().remaining(states.scene, states.robot[:, None])  # (P, 1)
        return _one_way(states, [-1], units, units > 0.0)

    def instruction(self, scene: Scene) -> str:
        return f"Drive {InRegion().phrase(scene)}."


@dataclass(frozen=True, repr=False)
class Together(Goal):
    """Both goals: the product of their scores."""

    first: Goal
    second: Goal

    def score(self, scene: Scene, poses: Poses) -> float:
        return self.first.score(scene, poses) * self.second.score(scene, poses)

    def ways(self, states: States) -> Floats:
        first = states.ways_of_part(self.first)[:, :, None]
        second = states.ways_of_part(self.second)[:, None]
        both: Floats = np.where(second > 0.0, second, first)
        return both.reshape(len(both), -1, both.shape[-1])

    def moved(self, scene: Scene) -> Blocks:
        return self.first.moved(scene) | self.second.moved(scene)

    def instruction(self, scene: Scene) -> str:
        return f"{self.first.instruction(scene)} {self.second.instruction(scene)}"


def _one_way(
    states: States, which: slice | list[int], units: Floats, unfinished: NDArray[np.bool_]
) -> Floats:
    """A single way from each state: K bodies have `units` (P, K) left to move, if unfinished."""
    ways = np.zeros((len(units), 1, len(states.scene.blocks) + 1))
    ways[:, 0, which] = np.where(unfinished, UNFINISHED + units, 0.0)
    return ways


def ways_at_start(goal: Goal, scene: Scene) -> Floats:
    """The ways (W, N + 1) to reach a goal from the scene."""
    ways: Floats = goal.ways(States(scene, Poses.at_rest(scene).bodies[None]))[0]
    return ways


def _units_to_gather(points: Floats) -> Floats:
    """Distances (P, K) that blocks at (P, K, 2) must move to be next to the best of them."""
    units = (lengths(points[:, :, None] - points[:, None]) - NEIGHBOUR_DISTANCE).clip(min=0.0)
    work = np.where(units > 0.0, UNFINISHED + units, 0.0).sum(axis=2)  # (P, K) around each
    best: Floats = units[np.arange(len(points)), work.argmin(axis=1)]
    return best


def _units_to_lines(points: Floats) -> Floats:
    """Distances (P, W, K) that blocks at (P, K, 2) must move into line with each pair of them."""
    first, second = np.triu_indices(points.shape[1], 1)
    start = points[:, first]  # (P, W, 2)
    along = points[:, second] - start
    length = lengths(along)[..., None]
    ux, uy = np.moveaxis(along / np.where(length > 0.0, length, 1.0), -1, 0)[..., None]
    x, y = np.moveaxis(points[:, None] - start[:, :, None], -1, 0)  # (P, W, K) each
    units: Floats = (np.abs(ux * y - uy * x) - INLIER_DISTANCE).clip(min=0.0)
    place = ux * x + uy * y
    order = place.argsort(axis=-1, kind="stable")
    gaps = np.diff(np.take_along_axis(place, order, axis=-1), axis=-1)
    following = order[..., 1:]
    more = np.take_along_axis(units, following, axis=-1) + (gaps - NEIGHBOUR_DISTANCE).clip(min=0.0)
    np.put_along_axis(units, following, more, axis=-1)
    return units


def problem(goal: Goal, scene: Scene) -> str:
    """Why no episode can start from the scene with this goal, or an empty string."""
    for part in goal.parts:
        if isinstance(part, Selection) and not part.blocks(scene):
            return f"{part!r} selects no block of the scene"
        if isinstance(part, Goal) and (reason := _unreachable(part, scene)):
            return f"{part!r}: {reason}"
    if goal.score(scene, Poses.at_rest(scene)) > SUCCESS:
        return f"{goal!r} is solved at the start"
    return ""


def _unreachable(goal: Goal, scene: Scene) -> str:
    """Why no final state of the scene can reach the goal, or an empty string."""
    if isinstance(goal, Clustered):
        kinds = {value_of(block, goal.attribute) for block in scene.blocks}
        return "" if len(kinds) > 1 else "expected blocks of at least two values, found fewer"
    if isinstance(goal, Together):
        return ""
    reachable = np.isfinite(ways_at_start(goal, scene)).all(axis=1).any()
    return "" if reachable else "there is no such place in the scene"


def progress(goal: Goal, scene: Scene, poses: Poses) -> float:
    """The potential whose increase is the dense reward, in units.

    It is the maximum, over all ways to reach the goal, of - sum of (UNFINISHED + d_i) - w, with d_i
    the distance that body i still has to move, and w the length of a path from between the robot's
    fingers to the nearest block that must move, and from each to the nearest one left. So it falls
    neither when a block is finished and the next one is far away nor when another way is better.
    """
    between_fingers = to_workspace((0.0, ROBOT_RADIUS + BLOCK_SIZE), poses.robot)
    points = positions(scene, poses)
    ways: list[list[float]] = goal.ways(States(scene, poses.bodies[None]))[0].tolist()
    return -min(
        sum(way) + _way_along(between_fingers, [point for i, point in enumerate(points) if way[i]])
        for way in ways
    )


def _way_along(start: Point, points: list[Point]) -> float:
    """Length of the path from a point through all others, each time to the nearest one left."""
    length, left = 0.0, list(points)
    while left:
        nearest = min(left, key=lambda point: math.dist(point, start))
        length += math.dist(nearest, start)
        left.remove(nearest)
        start = nearest
    return length
