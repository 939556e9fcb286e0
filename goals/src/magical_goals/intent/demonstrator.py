"""How likely demonstrations are under a goal, for a softly rational demonstrator.

In each state the demonstrator stops, or moves one thing somewhere. The preference for a move is
exponential in the work towards the goal that it saves, minus the cost of a move. Occasionally the
demonstrator slips: moves anything anywhere, or stops.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import qmc

from magical.scene import Poses, Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.poses import FIRST_BLOCK, ROBOT
from magical_goals.language.expressions import Floats
from magical_goals.language.goals import Goal, States

RATIONALITY = 8.0  # nats per unit of work
SLIPS = 0.2  # probability of a slip in each state
MOVE_COST = 0.25  # units of work: a move that saves less is not worthwhile
ALTERNATIVES = 96  # evenly spread other moves to compare with in each state
MARGIN = 0.12  # units from the walls to the places of other moves


class Episode:
    """A demonstration as moves, after which the demonstrator stopped.

    Attributes:
        scene: the initial scene.
    """

    def __init__(
        self, scene: Scene, states: Sequence[Poses], ends: Sequence[Poses], rng: np.random.Generator
    ) -> None:
        """Create an episode.

        Args:
            scene: the initial scene.
            states: the state in which each move was made, and the final one.
            ends: the state to which each move led.
            rng: samples the moves that could have been made instead.
        """
        self.scene, self._count = scene, len(states)
        others = [_random_moves(state.bodies, rng) for state in states]
        bodies = np.stack([state.bodies for state in (*states, *ends)])
        self._states = States(scene, np.concatenate([bodies, *others]))

    def log_likelihood(self, goal: Goal) -> float:
        """The log-likelihood in nats; that of a move is a density relative to random moves."""
        work = self._states.work(goal)
        if not np.isfinite(work).all():
            return -np.inf
        n = self._count
        states, ends, others = work[:n], work[n : 2 * n - 1], work[2 * n - 1 :].reshape(n, -1)
        alternatives = np.exp(RATIONALITY * (states[:, None] - others - MOVE_COST)).mean(axis=1)
        made = np.exp(RATIONALITY * (states[:-1] - ends - MOVE_COST))
        rational = np.append(made, 1.0) / (1.0 + alternatives)
        return float(np.log((1.0 - SLIPS) * rational + SLIPS / 2).sum())

    @property
    def log_likelihood_of_slips(self) -> float:
        """The log-likelihood, in nats, with no goal: in each state a random move, or a stop."""
        return self._count * math.log(0.5)


def _random_moves(bodies: Floats, rng: np.random.Generator) -> Floats:
    """The poses after each of `ALTERNATIVES` random moves of a block or the robot."""
    rows = np.array([ROBOT, *range(FIRST_BLOCK, len(bodies))])
    which, *places = qmc.Halton(3, rng=rng).random(ALTERNATIVES).T
    moves = np.repeat(bodies[None], ALTERNATIVES, axis=0)
    limit = WORKSPACE_HALF - MARGIN
    moved = rows[(which * len(rows)).astype(np.intp)]
    moves[np.arange(ALTERNATIVES), moved, :2] = (2 * np.stack(places, axis=1) - 1) * limit
    return moves
