"""How likely demonstrations are under a goal, for a softly rational demonstrator.

In each state the demonstrator stops, or moves one thing somewhere. Moves are preferred
exponentially by how much they take off the work that the goal leaves, less what a move costs. Now
and then the demonstrator slips: moves anything anywhere, or stops.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import qmc

from magical.scene import Poses, Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.poses import FIRST_BLOCK, ROBOT
from magical.tasks.programs import Goal
from magical.tasks.programs.states import Floats, States

RATIONALITY = 8.0  # nats for each unit of work
SLIPS = 0.2  # probability of a slip in each state
MOVE_COST = 0.25  # units of work: less is not worth a move
ALTERNATIVES = 96  # other moves that each state is compared with, spread evenly
MARGIN = 0.12  # units from the walls to the places of other moves


class Episode:
    """A demonstration as states: a move led from each to the next, none from the last.

    Attributes:
        scene: what it started from.
    """

    def __init__(self, scene: Scene, states: Sequence[Poses], rng: np.random.Generator) -> None:
        self.scene, self._count = scene, len(states)
        others = [_random_moves(state.bodies, rng) for state in states]
        bodies = np.stack([state.bodies for state in states])
        self._states = States(scene, np.concatenate([bodies, *others]))

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


def _random_moves(bodies: Floats, rng: np.random.Generator) -> Floats:
    """The poses after a block, or the robot, was moved to each of `ALTERNATIVES` random places."""
    rows = np.array([ROBOT, *range(FIRST_BLOCK, len(bodies))])
    which, *places = qmc.Halton(3, rng=rng).random(ALTERNATIVES).T
    moves = np.repeat(bodies[None], ALTERNATIVES, axis=0)
    limit = WORKSPACE_HALF - MARGIN
    moved = rows[(which * len(rows)).astype(np.intp)]
    moves[np.arange(ALTERNATIVES), moved, :2] = (2 * np.stack(places, axis=1) - 1) * limit
    return moves
