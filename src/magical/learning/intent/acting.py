"""What to move, and where to, by a belief about the goal.

Each program of the belief is a goal in the present scene. The next move is the one that takes most
off the work that is expected under all of them, as the demonstrator's was; if none takes off more
than a move costs, there is nothing left to do.
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

GOALS = 12  # the most probable ones that are acted on
LIKELY = 0.1  # probability that a thing must move: less is not considered
SATISFIED = 0.5  # of that probability at the decision: less, and the next one is made
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
        self._wanted = 0.0

    @property
    def is_known(self) -> bool:
        """Whether any program fits the scene."""
        return bool(self.goals)

    def decide(self, poses: Poses) -> Decision:
        """What to move now; the same as before until enough of the belief is content with it."""
        wanted = self.probabilities(poses)
        if not self._is_under_way(poses, wanted):
            likely = [thing for thing, probability in wanted.items() if probability > LIKELY]
            self._decision = self._choose(likely, poses)
            self._wanted = wanted[self._decision[0]] if self._decision else 0.0
        return self._decision

    def _is_under_way(self, poses: Poses, wanted: dict[int, float]) -> bool:
        """Whether the move that was decided on is still to be finished."""
        if self._decision is None:
            return False
        thing, place = self._decision
        arrived = math.dist(poses.bodies[_row(thing), :2], place) < AT_PLACE
        return not arrived and wanted.get(thing, 0.0) >= SATISFIED * self._wanted

    def probabilities(self, poses: Poses) -> dict[int, float]:
        """How probable it is that each block, or the robot, has still to move."""
        states = States(self.scene, [poses])
        found: dict[int, float] = {}
        for goal, weight in self.goals:
            for thing in np.flatnonzero(states.best_way(goal)[0]).tolist():
                number = thing if thing < len(self.scene.blocks) else ROBOT_TARGET
                found[number] = found.get(number, 0.0) + weight
        return found

    def _choose(self, things: Sequence[int], poses: Poses) -> Decision:
        """The thing and the place with the highest gain, or neither if none is worth a move."""
        now = float(self._expected_work([poses])[0])
        best, choice = -math.inf, None
        for thing in things:
            work = self.work_at_places(thing, poses)
            ways = NEARNESS * _ways(thing, poses)
            place = int(np.argmin(work + _smooth(work) + ways))
            gain = now - float(work[place])
            if gain > MOVE_COST and gain - ways[place] > best:
                best, choice = gain - ways[place], (thing, place)
        if choice is None:
            return None
        x, y = PLACES[choice[1]].tolist()
        return choice[0], (x, y)

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


def _ways(thing: int, poses: Poses) -> Floats:
    """Units from the gripper to the thing, and from there to each of the places."""
    start = poses.bodies[_row(thing), :2]
    way: Floats = np.linalg.norm(PLACES - start, axis=1)
    if thing != ROBOT_TARGET:
        way += math.dist(to_workspace((0.0, GRIP), poses.robot), start)
    return way


def _smooth(costs: Floats) -> Floats:
    """The mean over each cell and those around it: places are not reached exactly."""
    grid = np.pad(costs.reshape(CELLS, CELLS), 1, mode="edge")
    around = [grid[i : i + CELLS, j : j + CELLS] for i in range(3) for j in range(3)]
    smooth: Floats = np.mean(around, axis=0).ravel()
    return smooth
