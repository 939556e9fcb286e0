"""What to move, and where to, given a belief about the goal.

One of the things most likely to have to move is moved next, to the place with the least expected
work under all goals, including the way there; where goals leave a choice, near where demonstrations
ended. If no such move saves more work than a move costs,
the other things are considered; if none of their moves does either, nothing is left to do.
"""

import math

import numpy as np

from magical.experts.geometry import CONTACT_DISTANCE
from magical.scene import FIRST_BLOCK, ROBOT, Point, Poses, Scene, to_workspace
from magical.tasks import get_task
from magical_goals.intent.meanings import Chosen, replace_selections
from magical_goals.intent.posterior import MOVE_COST, Belief
from magical_goals.language.expressions import Floats
from magical_goals.language.goals import Goal, States, problem
from magical_goals.objects.control import GRIP, ROBOT_TARGET
from magical_goals.planning.planner import APART, BLOCK_ROOM
from magical_goals.planning.routes import MOVED, Routes

GOALS = 8  # the most probable ones, which are acted on
PRESSING = 0.8  # share of the highest probability: things less likely to have to move come later
CHANGE = 0.05  # units of expected work: less is no reason to decide again
NEARNESS = 0.2  # units of work per unit of the way to a thing, and of its way to its place
FAMILIARITY = 0.1  # units of work per unit from the nearest place where a demonstration ended
CLEARANCE = 0.24  # units between blocks' centres: closer blocks would touch
CROWDED = 1.0  # units of work that such a place costs
CELLS, BORDER = 14, 0.9  # of the grid of places; units
_AXIS = (np.arange(CELLS) + 0.5) * 2 * BORDER / CELLS - BORDER
PLACES = np.stack(np.meshgrid(_AXIS, _AXIS, indexing="ij"), axis=-1).reshape(-1, 2)

Decision = tuple[int, Point] | None  # a block or `ROBOT_TARGET`, and its place; None: stop


class Intention:
    """The belief in one episode, and the current move."""

    def __init__(self, belief: Belief, scene: Scene) -> None:
        """Find the goals that the belief's programs express in the scene, if valid there."""
        self.scene = scene
        goals: dict[Goal, float] = {}
        for program, weight in belief.explanations if belief.is_explained else ():
            goal = replace_selections(program, lambda s: Chosen(s.blocks(scene)))
            goals[goal] = goals.get(goal, 0.0) + weight
        possible = [each for each in goals.items() if not problem(each[0], scene)]
        likely = sorted(possible, key=lambda each: -each[1])[:GOALS]
        total = sum(weight for _, weight in likely)
        self.goals = [(goal, weight / total) for goal, weight in likely]
        self._strangeness = np.zeros(len(PLACES))
        if belief.ends:
            away = np.linalg.norm(PLACES[:, None] - np.array(belief.ends), axis=2)
            self._strangeness = FAMILIARITY * away.min(axis=1)
        self._decision: Decision = None
        self._work = math.inf  # expected at the time of the decision
        self._blocks = np.full((len(scene.blocks), 2), math.inf)  # where they lay at that time

    @property
    def is_known(self) -> bool:
        """Whether any program fits the scene."""
        return bool(self.goals)

    def decide(self, poses: Poses) -> Decision:
        """What to move now; the same as before as long as it is worth moving."""
        blocks = poses.blocks[:, :2]
        robot_moves = self._decision is not None and self._decision[0] == ROBOT_TARGET
        if len(blocks) and not robot_moves and (np.abs(blocks - self._blocks) < MOVED).all():
            return self._decision
        self._blocks = blocks.copy()
        after = poses.bodies.copy()
        if self._decision is not None:
            thing, place = self._decision
            after[row_of(thing), :2] = place
        now, then = self._expected_work(np.stack([poses.bodies, after])).tolist()
        kept = abs(now - self._work) < CHANGE if self._decision is None else now - then > MOVE_COST
        if not kept:
            self._decision = self._choose(poses)
            self._work = now
        return self._decision

    def probabilities(self, poses: Poses) -> dict[int, float]:
        """The probability that each block, or the robot, still has to move."""
        found: dict[int, float] = {}
        for things, weight in self._to_move(poses):
            for thing in things:
                found[thing] = found.get(thing, 0.0) + weight
        return found

    def confidence(self, poses: Poses) -> float:
        """The probability that what is decided has to move; 0 if no program fits the scene."""
        if not self.is_known:
            return 0.0
        decision = self.decide(poses)
        found = self._to_move(poses)
        return sum(
            weight
            for things, weight in found
            if (not things if decision is None else decision[0] in things)
        )

    def _to_move(self, poses: Poses) -> list[tuple[set[int], float]]:
        """What still has to move under each goal, and the goal's probability."""
        states = States(self.scene, poses.bodies[None])
        robot = len(self.scene.blocks)
        found = []
        for goal, weight in self.goals:
            rows = np.flatnonzero(states.best_way(goal)[0]).tolist()
            found.append(({ROBOT_TARGET if row == robot else row for row in rows}, weight))
        return found

    def _choose(self, poses: Poses) -> Decision:
        """The best worthwhile move, first of what most likely has to move, else of the rest."""
        now = float(self._expected_work(poses.bodies[None])[0])
        if now <= MOVE_COST:
            return None
        wanted = self.probabilities(poses)
        pressing = PRESSING * max(wanted.values(), default=0.0)
        grip = to_workspace((0.0, GRIP), poses.robot)
        for group in (True, False):
            moves = []
            for thing in (ROBOT_TARGET, *range(len(self.scene.blocks))):
                if (wanted.get(thing, 0.0) >= pressing) is group:
                    work = self.work_at_places(thing, poses)
                    cost = work + _smooth(work) + NEARNESS * _ways_to_places(thing, poses)
                    cost += self._strangeness
                    best = int(np.argmin(cost))
                    if now - work[best] > MOVE_COST:
                        away = math.dist(poses.bodies[row_of(thing), :2], grip)
                        moves.append((float(cost[best]) + NEARNESS * away, thing, best))
            if moves:
                _, thing, best = min(moves)
                x, y = PLACES[best].tolist()
                return thing, (x, y)
        return None

    def work_at_places(self, thing: int, poses: Poses) -> Floats:
        """Expected work with a thing at each of `PLACES`; more where blocks would touch."""
        bodies = np.repeat(poses.bodies[None], len(PLACES), axis=0)
        bodies[:, row_of(thing), :2] = PLACES
        work = self._expected_work(bodies)
        if thing != ROBOT_TARGET:
            others = np.delete(poses.blocks[:, :2], thing, axis=0)
            gaps = np.linalg.norm(PLACES[:, None] - others, axis=2)
            work += CROWDED * (gaps < CLEARANCE).any(axis=1)
        return work

    def _expected_work(self, bodies: Floats) -> Floats:
        """The expected work (P,) in each state (P, 5 + N, 3)."""
        states = States(self.scene, bodies)
        weights = [weight for _, weight in self.goals]
        expected: Floats = np.dot(weights, [states.work(goal) for goal, _ in self.goals])
        return expected


def confidence_by_variant(belief: Belief, task: str, scenes: int) -> dict[str, float]:
    """Mean `Intention.confidence` over sampled scenes, the same every time, of each variant."""
    found = {}
    for variant in get_task(task).variants:
        rng = np.random.default_rng(0)
        sampled = [get_task(task).sample(variant, rng)[0] for _ in range(scenes)]
        each = [Intention(belief, scene).confidence(Poses.at_rest(scene)) for scene in sampled]
        found[variant] = float(np.mean(each))
    return found


def row_of(thing: int) -> int:
    """The row of a block, or of `ROBOT_TARGET`, in `Poses.bodies`."""
    return ROBOT if thing == ROBOT_TARGET else FIRST_BLOCK + thing


def _ways_to_places(thing: int, poses: Poses) -> Floats:
    """The length, in units, of a thing's route to each place, around the other blocks."""
    others = poses.blocks[[row for row in range(len(poses.blocks)) if row != thing], :2]
    rooms = np.full(len(others), CONTACT_DISTANCE if thing == ROBOT_TARGET else APART + BLOCK_ROOM)
    start = poses.bodies[row_of(thing), :2]
    return Routes(start[None], np.zeros(1), others, rooms, BORDER).at(PLACES)[0]


def _smooth(costs: Floats) -> Floats:
    """The mean over each cell and its neighbours, as places are not reached exactly."""
    grid = np.pad(costs.reshape(CELLS, CELLS), 1, mode="edge")
    around = [grid[i : i + CELLS, j : j + CELLS] for i in range(3) for j in range(3)]
    smooth: Floats = np.mean(around, axis=0).ravel()
    return smooth
