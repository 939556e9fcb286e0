"""How likely demonstrations are under a goal, for a softly rational demonstrator.

In each state the demonstrator stops, or moves one thing somewhere. Moves are preferred
exponentially by how much they take off the work that the goal leaves, less what a move costs. Now
and then the demonstrator slips: moves anything anywhere, or stops.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from magical.scene import Poses, Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.poses import FIRST_BLOCK, ROBOT
from magical.tasks.programs import Each, Every, Exactly, Goal, OneOf, Only, Place, Together
from magical.tasks.programs.goals import UNFINISHED
from magical.tasks.scoring import positions

RATIONALITY = 8.0  # nats for each unit of work
SLIPS = 0.2  # probability of a slip in each state
MOVE_COST = 0.25  # units of work: less is not worth a move
ALTERNATIVES = 96  # other moves that each state is compared with, spread evenly
MARGIN = 0.12  # units from the walls to the places of other moves

Floats = NDArray[np.float64]


class States:
    """States of an episode, and the work that goals leave in them.

    Attributes:
        scene: what the episode started from.
        poses: of P states.
    """

    def __init__(self, scene: Scene, poses: Sequence[Poses]) -> None:
        self.scene, self.poses = scene, poses
        self._points = [positions(scene, each) for each in poses]
        self._known: dict[Goal, Floats] = {}
        self._units: dict[Place, Floats] = {}

    def work(self, goal: Goal) -> Floats:
        """Units of work that the best way to reach the goal leaves: (P,)."""
        work: Floats = self._ways(goal).sum(axis=2).min(axis=1)
        return work

    def best_way(self, goal: Goal) -> Floats:
        """What that way leaves to be done for each block, and last for the robot: (P, N + 1)."""
        ways = self._ways(goal)
        best: Floats = ways[np.arange(len(ways)), ways.sum(axis=2).argmin(axis=1)]
        return best

    def _ways(self, goal: Goal) -> Floats:
        """The same of each of W ways: (P, W, N + 1), with what beginning costs for each thing."""
        if isinstance(goal, Exactly):
            goal = goal.both
        if isinstance(goal, Together):
            first, second = self._ways(goal.first)[:, :, None], self._ways(goal.second)[:, None]
            return np.where(second > 0.0, second, first).reshape(len(first), -1, first.shape[-1])
        if isinstance(goal, Only):
            goal = goal.others
        if isinstance(goal, Each | Every | OneOf):
            return self._placed(goal)
        if goal not in self._known:
            ways = [_as_array(goal, self.scene, poses) for poses in self.poses]
            most = max(map(len, ways))
            self._known[goal] = np.stack([w[np.arange(most).clip(max=len(w) - 1)] for w in ways])
        return self._known[goal]

    def _placed(self, goal: Each | Every | OneOf) -> Floats:
        """`_ways` of goals that have a place: most goals, so each place is measured only once."""
        place, chosen = goal.place, sorted(goal.selection.blocks(self.scene))
        if place not in self._units:
            blocks = range(len(self.scene.blocks))
            units = [[place.remaining(self.scene, b, at) for b in blocks] for at in self._points]
            self._units[place] = np.array(units)  # (P, N)
        left = self._units[place][:, chosen]
        left = np.where(left > 0.0, UNFINISHED + left, 0.0)
        ways = range(len(chosen)) if isinstance(goal, OneOf) else 0
        work = np.zeros((len(left), len(chosen) if ways else 1, len(self.scene.blocks) + 1))
        work[:, ways, chosen] = left
        return work


class Episode:
    """A demonstration as states: a move led from each to the next, none from the last.

    Attributes:
        scene: what it started from.
    """

    def __init__(self, scene: Scene, states: Sequence[Poses], rng: np.random.Generator) -> None:
        self.scene, self._count = scene, len(states)
        others = [move for state in states for move in _random_moves(state, rng)]
        self._states = States(scene, [*states, *others])

    def log_likelihood(self, goal: Goal) -> float:
        """Nats; a move's likelihood is a density relative to random moves."""
        work = self._states.work(goal)
        if not np.isfinite(work).all():
            return -np.inf
        states, others = work[: self._count], work[self._count :].reshape(self._count, -1)
        alternatives = np.exp(RATIONALITY * (states[:, None] - others - MOVE_COST)).mean(axis=1)
        made = np.exp(RATIONALITY * (states[:-1] - states[1:] - MOVE_COST))
        rational = np.append(made, 1.0) / (1.0 + alternatives)
        return float(np.log((1.0 - SLIPS) * rational + SLIPS / 2).sum())

    @property
    def log_likelihood_of_slips(self) -> float:
        """Nats, of a demonstrator without a goal: in each state a random move or none."""
        return self._count * math.log(0.5)


def _random_moves(poses: Poses, rng: np.random.Generator) -> list[Poses]:
    """The poses after a block, or the robot, was moved to a random place."""
    rows = [ROBOT, *range(FIRST_BLOCK, len(poses.bodies))]
    limit = WORKSPACE_HALF - MARGIN
    found = []
    for which, x, y in qmc.Halton(3, rng=rng).random(ALTERNATIVES):
        bodies = poses.bodies.copy()
        bodies[rows[int(which * len(rows))], :2] = (2 * x - 1) * limit, (2 * y - 1) * limit
        found.append(Poses(bodies))
    return found


def _as_array(goal: Goal, scene: Scene, poses: Poses) -> Floats:
    """The ways to reach the goal, (W, N + 1)."""
    ways = goal.ways(scene, poses)
    work = np.zeros((len(ways), len(scene.blocks) + 1))
    for row, remaining in zip(work, ways, strict=True):
        for block, left in remaining.items():
            row[-1 if block is None else block] = UNFINISHED + left
    return work
