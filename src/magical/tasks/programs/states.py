"""Batches of states of an episode, and the work that goals leave in each of them."""

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
    """P states of an episode with N blocks.

    Attributes:
        scene: the episode's initial scene.
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
