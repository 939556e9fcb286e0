"""Many states of an episode at once, and what goals leave to be done in them."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from magical.scene import Scene
from magical.scene.poses import FIRST_BLOCK, ROBOT

if TYPE_CHECKING:
    from magical.tasks.programs.goals import Goal
    from magical.tasks.programs.places import Place

Floats = NDArray[np.float64]


class States:
    """P states of an episode of N blocks.

    Attributes:
        scene: what the episode started from.
        robot: (P, 2) the robot's position, in units.
        points: (P, N, 2) the blocks' centres, in units.
    """

    def __init__(self, scene: Scene, bodies: Floats) -> None:
        """Take poses (P, 5 + N, 3) as in `Poses.bodies`."""
        self.scene = scene
        self.robot, self.points = bodies[:, ROBOT, :2], bodies[:, FIRST_BLOCK:, :2]
        self._units: dict[Place, Floats] = {}
        self._parts: dict[Goal, Floats] = {}

    def units(self, place: "Place") -> Floats:
        """Units (P, N) that each block has still to go to a place, measured once."""
        if place not in self._units:
            self._units[place] = place.remaining(self.scene, self.points)
        return self._units[place]

    def ways_of_part(self, goal: "Goal") -> Floats:
        """A goal's ways, which are kept, because several goals may share a part."""
        if goal not in self._parts:
            self._parts[goal] = goal.ways(self)
        return self._parts[goal]

    def work(self, goal: "Goal") -> Floats:
        """Units of work that the best way to reach a goal leaves: (P,)."""
        work: Floats = goal.ways(self).sum(axis=2).min(axis=1)
        return work

    def best_way(self, goal: "Goal") -> Floats:
        """What the way with the least work leaves for each block and the robot: (P, N + 1)."""
        ways = goal.ways(self)
        best: Floats = ways[np.arange(len(ways)), ways.sum(axis=2).argmin(axis=1)]
        return best
