"""Worse demonstrations on purpose, for studies of mixed quality.

What falls short of full skill shows as noise (an action kept up by mistake for a few steps),
detours (a drive to nowhere before a move begins) and wrong goals (a move that ends elsewhere).
"""

from dataclasses import dataclass, replace

import numpy as np

from magical.errors import InvalidConfigError
from magical.experts.goals import Move
from magical.scene.actions import NUM_ACTIONS

SLIP = 0.22  # chance, at no skill, that a control step begins a slip
SLIP_STEPS = 3  # control steps that a slip lasts at most
WRONG_GOAL = 0.6  # chance, at no skill, that a move ends in a wrong place
ASTRAY = 0.6  # units in each coordinate by which it may do so
DETOUR = 0.5  # chance, at no skill, that a move begins with a detour
DETOUR_STEPS = 12  # control steps that a detour lasts at most


@dataclass(slots=True)
class Clumsiness:
    """Draws a demonstrator's mistakes; `lack` is 1 - skill, in [0, 1]."""

    lack: float
    rng: np.random.Generator
    slip: int = 0  # the action of the present slip
    left: int = 0  # control steps that it goes on

    def __post_init__(self) -> None:
        if not 0.0 <= self.lack <= 1.0:
            raise InvalidConfigError(
                f"skill: expected a number from 0 to 1, found {1.0 - self.lack}; 1 is the best"
            )

    def disturb(self, action: int) -> int:
        """The action that is taken instead of the one intended."""
        if not self.left and self.rng.random() < self.lack * SLIP:
            self.slip = int(self.rng.integers(NUM_ACTIONS))
            self.left = int(self.rng.integers(1, SLIP_STEPS + 1))
        if not self.left:
            return action
        self.left -= 1
        return self.slip

    def detour(self) -> int:
        """For how many control steps the next move is put off."""
        if self.rng.random() >= self.lack * DETOUR:
            return 0
        return int(self.rng.integers(1, DETOUR_STEPS + 1))

    def mislead(self, move: Move) -> Move:
        """The move as it is made: now and then to a wrong place."""
        if self.rng.random() >= self.lack * WRONG_GOAL:
            return move
        dx, dy = self.rng.uniform(-ASTRAY, ASTRAY, size=2).tolist()
        x, y = (min(0.8, max(-0.8, v)) for v in (move.goal[0] + dx, move.goal[1] + dy))
        return replace(move, goal=(x, y), area=None)
