"""What to move, and where to, by a belief about the goal.

Each program of the belief is a goal in the present scene. A block is moved if enough of the belief
wants it moved, to the place that leaves least work on average.
"""

import math
from collections.abc import Sequence

import numpy as np

from magical.learning.intent.demonstrator import work_of
from magical.learning.intent.meanings import Chosen, replace_selections
from magical.learning.intent.posterior import Belief
from magical.learning.objects.hindsight import ROBOT_TARGET
from magical.learning.objects.table import GRIP
from magical.scene import Poses, Scene
from magical.scene.geometry import Point, to_workspace
from magical.scene.poses import FIRST_BLOCK, ROBOT
from magical.tasks.programs import Goal, Selection, problem

SURE = 0.8  # probability that nothing is left to do, at which to stop
WANTED = 0.5  # of the most wanted block's probability: what others need to be chosen for nearness
NEARNESS = 0.2  # units of work for each unit from block to place: breaks ties
CLEARANCE = 0.24  # units between blocks' centres: nearer ones would touch
CROWDED = 1.0  # units of work that such a place costs
CELLS, BORDER = 16, 0.9  # of the grid of places; units
_AXIS = (np.arange(CELLS) + 0.5) * 2 * BORDER / CELLS - BORDER
PLACES = [(x, y) for x in _AXIS.tolist() for y in _AXIS.tolist()]

Decision = tuple[int, Point] | None  # a block or `ROBOT_TARGET`, and its place; None: stop


class Intention:
    """The belief in one episode, and what it is presently acting on."""

    def __init__(self, belief: Belief, scene: Scene) -> None:
        """Find the goals that the belief's programs are in the scene.

        Programs that cannot be tasks there are left out.
        """
        self.scene = scene
        goals: dict[Goal, float] = {}
        for program, weight in zip(belief.programs, belief.weights, strict=True):
            goal = replace_selections(program, self._chosen)
            goals[goal] = goals.get(goal, 0.0) + weight
        possible = {goal: weight for goal, weight in goals.items() if not problem(goal, scene)}
        total = sum(possible.values())
        self.goals = [(goal, weight / total) for goal, weight in possible.items()]
        self._decision: Decision = None

    def _chosen(self, selection: Selection) -> Chosen:
        return Chosen(selection.blocks(self.scene))

    @property
    def is_known(self) -> bool:
        """Whether any program fits the scene."""
        return bool(self.goals)

    def wanted(self, poses: Poses) -> dict[int, float]:
        """How probable it is that each block, or the robot, has still to move."""
        found: dict[int, float] = {}
        for goal, weight in self.goals:
            for block in goal.remaining(self.scene, poses):
                number = ROBOT_TARGET if block is None else block
                found[number] = found.get(number, 0.0) + weight
        return found

    def decide(self, poses: Poses) -> Decision:
        """What to move now; the same block as before while it is wanted."""
        done = sum(w for goal, w in self.goals if not goal.remaining(self.scene, poses))
        wanted = self.wanted(poses)
        if done > SURE or not wanted:
            self._decision = None
        elif self._decision is None or wanted.get(self._decision[0], 0.0) < WANTED / 2:
            target = self._choose(wanted, poses)
            self._decision = target, self._place(target, poses)
        return self._decision

    def _choose(self, wanted: dict[int, float], poses: Poses) -> int:
        """The nearest of the blocks that are wanted most."""
        grip = to_workspace((0.0, GRIP), poses.robot)
        among = [b for b, p in wanted.items() if p >= WANTED * max(wanted.values())]
        return min(among, key=lambda b: 0.0 if b < 0 else math.dist(poses.blocks[b, :2], grip))

    def _place(self, target: int, poses: Poses) -> Point:
        """The centre of the best cell, judged with the cells around it."""
        row = ROBOT if target == ROBOT_TARGET else FIRST_BLOCK + target
        about = [(g, w) for g, w in self.goals if _moves(g, self.scene, poses, target)]
        costs = np.array([self._cost(about, poses, row, place) for place in PLACES])
        grid = np.pad(costs.reshape(CELLS, CELLS), 1, mode="edge")
        size = CELLS
        around = sum(grid[i : i + size, j : j + size] for i in range(3) for j in range(3)) / 9
        return PLACES[int(np.argmin(around))]

    def _cost(
        self, goals: Sequence[tuple[Goal, float]], poses: Poses, row: int, place: Point
    ) -> float:
        bodies = poses.bodies.copy()
        start = bodies[row, :2].copy()
        bodies[row, :2] = place
        moved = Poses(bodies)
        others = np.delete(bodies[FIRST_BLOCK:, :2], row - FIRST_BLOCK, axis=0) if row else []
        crowded = any(math.dist(place, other) < CLEARANCE for other in others)
        work = sum(weight * work_of(goal, self.scene, moved).sum() for goal, weight in goals)
        return float(work + CROWDED * crowded + NEARNESS * math.dist(start, place))


def _moves(goal: Goal, scene: Scene, poses: Poses, target: int) -> bool:
    return (None if target == ROBOT_TARGET else target) in goal.remaining(scene, poses)
