"""Deliberately worse demonstrations: random actions, detours and wrong goals.

In perturbed demonstrations, random actions replace some of the expert's. The expert recovers from
the states that these lead to, so the demonstrations show more states than it reaches on its own
(Laskey et al., "DART: noise injection for robust imitation learning", CoRL 2017). An expert below
full skill, for studies of mixed-quality data, makes its own mistakes: see `ActionNoise`.
"""

from dataclasses import dataclass, replace

import numpy as np

from magical.errors import InvalidConfigError
from magical.experts.geometry import ROBOT_LIMIT
from magical.experts.planning import Move
from magical.scene import NUM_ACTIONS

MAX_PERTURBED_STEPS = 5  # control steps: longest hold of a random action. Chosen, not tuned

# The noise at skill 0; chances grow linearly with 1 - skill. Chosen, not tuned.
RANDOM_ACTION_CHANCE = 0.22  # that a control step begins a random action
RANDOM_ACTION_STEPS = 3  # control steps for which one is held at most
WRONG_GOAL_CHANCE = 0.6  # that a move ends in a wrong place
GOAL_ERROR = 0.6  # units in each coordinate by which it may be wrong
DETOUR_CHANCE = 0.5  # that a move begins with a detour
DETOUR_STEPS = 12  # control steps that a detour lasts at most


def check_share(name: str, share: float) -> None:
    """Raise `InvalidConfigError`, with `name` in the message, if `share` is not from 0 to 1."""
    if not 0.0 <= share <= 1.0:
        raise InvalidConfigError(f"{name}: expected a number from 0 to 1, found {share}")


@dataclass(slots=True)
class RandomActions:
    """Random actions in place of given ones, each held for 1 to `max_steps` control steps."""

    chance: float  # that one begins in a control step in which none is held
    max_steps: int
    rng: np.random.Generator  # not used if the chance is 0
    held: int = 0  # the one being held
    steps_left: int = 0  # control steps for which it is still held

    def execute(self, action: int) -> int:
        """The action to execute: a random one, or `action` itself."""
        if not self.steps_left and self.chance > 0.0 and self.rng.random() < self.chance:
            self.held = int(self.rng.integers(NUM_ACTIONS))
            self.steps_left = int(self.rng.integers(1, self.max_steps + 1))
        if not self.steps_left:
            return action
        self.steps_left -= 1
        return self.held


def perturbation(share: float, rng: np.random.Generator) -> RandomActions:
    """Random actions in an average share, from 0 to 1, of the control steps.

    Raises:
        InvalidConfigError: the share is not between 0 and 1.
    """
    check_share("perturb", share)
    mean_steps = (1 + MAX_PERTURBED_STEPS) / 2
    chance = share / (share + mean_steps * (1.0 - share))
    return RandomActions(chance, MAX_PERTURBED_STEPS, rng)


class ActionNoise:
    """Perturbs the actions and moves of an expert below full skill.

    Raises:
        InvalidConfigError: the skill is not between 0 and 1.
    """

    def __init__(self, skill: float, rng: np.random.Generator) -> None:
        check_share("skill", skill)
        self._level, self._rng = 1.0 - skill, rng
        self.actions = RandomActions(self._level * RANDOM_ACTION_CHANCE, RANDOM_ACTION_STEPS, rng)

    def sample_detour(self) -> int:
        """Control steps of driving elsewhere before the next move, most often 0."""
        if self._rng.random() >= self._level * DETOUR_CHANCE:
            return 0
        return int(self._rng.integers(1, DETOUR_STEPS + 1))

    def perturb_goal(self, move: Move) -> Move:
        """The move to make, sometimes to a wrong place inside the workspace."""
        if self._rng.random() >= self._level * WRONG_GOAL_CHANCE:
            return move
        dx, dy = self._rng.uniform(-GOAL_ERROR, GOAL_ERROR, size=2).tolist()
        x, y = np.clip((move.goal[0] + dx, move.goal[1] + dy), -ROBOT_LIMIT, ROBOT_LIMIT).tolist()
        return replace(move, goal=(x, y), area=None)
