"""What to move, and where to, by a belief about the goal.

Each program of the belief is a goal in the present scene. What is moved next is the nearest of the
things that must move most probably, to the place where the least work is expected under all goals.
If no move takes off more work than it costs, there is nothing left to do.
"""

import math
from collections.abc import Sequence

import numpy as np

from magical.learning.intent.demonstrator import MOVE_COST, Floats, States
from magical.learning.intent.meanings import Chosen, replace_selections
from magical.learning.intent.posterior import Belief
from magical.learning.objects.hindsight import ROBOT_TARGET
from magical.learning.objects.table import GRIP
from magical.scene import Poses, Scene
from magical.scene.geometry import Point, to_workspace
from magical.scene.poses import FIRST_BLOCK, ROBOT
from magical.tasks.programs import Goal, problem

GOALS = 8  # the most probable ones that are acted on
LIKELY = 0.1  # probability that a thing must move: less is not considered
SATISFIED = 0.5  # of the highest probability, or of that at the decision: less is not pressing
AT_PLACE = 0.06  # units: nearer to its place, a move is finished
NEARNESS = (
    0.2  # units of work for each unit from gripper to thing, and on to its place: breaks ties
)
CLEARANCE = 0.24  # units between blocks' centres: nearer ones would touch
CROWDED = 1.0  # units of work that such a place costs
CELLS, BORDER = 14, 0.9  # of the grid of places; units
_AXIS = (np.arange(CELLS) + 0.5) * 2 * BORDER / CELLS - BORDER
PLACES = np.stack(np.meshgrid(_AXIS, _AXIS, indexing="ij"), axis=-1).reshape(-1, 2)

Decision = tuple[int, Point] | None  # a block or `ROBOT_TARGET`, and its place; None: stop


class Intention:
    """The belief in one episode, and the move that is presently made."""

    def __init__(self, belief: Belief, scene: Scene) -> None:
        """Find the goals that the belief's programs are in the scene.

        Programs that cannot be tasks there are left out.
        """
        self.scene = scene
        goals: dict[Goal, float] = {}
        for program, weight in belief.explanations if belief.is_explained else ():
            goal = replace_selections(program, lambda s: Chosen(s.blocks(scene)))
            goals[goal] = goals.get(goal, 0.0) + weight
        possible = [each for each in goals.items() if not problem(each[0], scene)]
        likely = sorted(possible, key=lambda each: -each[1])[:GOALS]
        total = sum(weight for _, weight in likely)
        self.goals = [(goal, weight / total) for goal, weight in likely]
        self._decision: Decision = None
        self._wanted: dict[int, float] | None = None  # when that was decided
        self._was_there = False

    @property
    def is_known(self) -> bool:
        """Whether any program fits the scene."""
        return bool(self.goals)

    def decide(self, poses: Poses) -> Decision:
        """What to move now; the same as before until enough of the belief is content with it."""
        wanted = self.probabilities(poses)
        if self._is_finished(poses, wanted):
            self._decision = self._choose(wanted, poses)
            self._wanted, self._was_there = wanted, self._is_there(poses)
        return self._decision

    def _is_finished(self, poses: Poses, wanted: dict[int, float]) -> bool:
        """Whether it is time to decide: at first, and when something changed."""
        if self._wanted is None or self._decision is None:
            return wanted != self._wanted
        thing = self._decision[0]
        is_content = wanted.get(thing, 0.0) < SATISFIED * self._wanted[thing]
        return is_content or (self._is_there(poses) and not self._was_there)

    def _is_there(self, poses: Poses) -> bool:
        """Whether what is moved lies at its place, or nothing is moved."""
        if self._decision is None:
            return True
        thing, place = self._decision
        return math.dist(poses.bodies[_row(thing), :2], place) < AT_PLACE

    def probabilities(self, poses: Poses) -> dict[int, float]:
        """How probable it is that each block, or the robot, has still to move."""
        states = States(self.scene, [poses])
        found: dict[int, float] = {}
        for goal, weight in self.goals:
            for thing in np.flatnonzero(states.best_way(goal)[0]).tolist():
                number = thing if thing < len(self.scene.blocks) else ROBOT_TARGET
                found[number] = found.get(number, 0.0) + weight
        return found

    def _choose(self, wanted: dict[int, float], poses: Poses) -> Decision:
        """The nearest of what must move most probably, then of the rest, if it is worth a move."""
        now = float(self._expected_work([poses])[0])
        grip = to_workspace((0.0, GRIP), poses.robot)
        sure = SATISFIED * max(wanted.values(), default=0.0)
        order = sorted(
            (wanted[thing] < sure, math.dist(poses.bodies[_row(thing), :2], grip), thing)
            for thing in wanted
            if wanted[thing] > LIKELY
        )
        for *_, thing in order:
            work = self.work_at_places(thing, poses)
            way = np.linalg.norm(PLACES - poses.bodies[_row(thing), :2], axis=1)
            best = int(np.argmin(work + _smooth(work) + NEARNESS * way))
            if now - work[best] > MOVE_COST:
                x, y = PLACES[best].tolist()
                return thing, (x, y)
        return None

    def work_at_places(self, thing: int, poses: Poses) -> Floats:
        """Expected work if the thing lay at each place; more if it touched a block there."""
        row = _row(thing)
        bodies = np.repeat(poses.bodies[None], len(PLACES), axis=0)
        bodies[:, row, :2] = PLACES
        work = self._expected_work([Poses(each) for each in bodies])
        if row != ROBOT:
            others = np.delete(poses.blocks[:, :2], thing, axis=0)
            gaps = np.linalg.norm(PLACES[:, None] - others, axis=2)
            work += CROWDED * (gaps < CLEARANCE).any(axis=1)
        return work

    def _expected_work(self, poses: Sequence[Poses]) -> Floats:
        states = States(self.scene, poses)
        weights = [weight for _, weight in self.goals]
        expected: Floats = np.dot(weights, [states.work(goal) for goal, _ in self.goals])
        return expected


def _row(thing: int) -> int:
    return ROBOT if thing == ROBOT_TARGET else FIRST_BLOCK + thing


def _smooth(costs: Floats) -> Floats:
    """The mean over each cell and those around it: places are not reached exactly."""
    grid = np.pad(costs.reshape(CELLS, CELLS), 1, mode="edge")
    around = [grid[i : i + CELLS, j : j + CELLS] for i in range(3) for j in range(3)]
    smooth: Floats = np.mean(around, axis=0).ravel()
    return smooth
