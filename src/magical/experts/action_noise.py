"""Worse demonstrations on purpose, for studies of mixed-quality data.

What a demonstrator lacks in skill becomes random actions held for a few control steps, detours
before a move, and moves to wrong goals.
"""

from dataclasses import dataclass, replace

import numpy as np

from magical.errors import InvalidConfigError
from magical.experts.distances import ROBOT_LIMIT
from magical.experts.planning import Move
from magical.scene import NUM_ACTIONS


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """The noise at skill 0; chances grow linearly with 1 - skill. Chosen, not tuned."""

    random_action_chance: float = 0.22  # that a control step begins a random action
    random_action_steps: int = 3  # control steps that one is held at most
    wrong_goal_chance: float = 0.6  # that a move ends in a wrong place
    goal_error: float = 0.6  # units in each coordinate by which it may be wrong
    detour_chance: float = 0.5  # that a move begins with a detour
    detour_steps: int = 12  # control steps that a detour lasts at most


NOISE = NoiseSettings()


@dataclass(slots=True)
class ActionNoise:
    """Perturbs what an expert does; raises `InvalidConfigError` where `level` is not in [0, 1]."""

    level: float  # 1 - skill
    rng: np.random.Generator
    random_action: int = 0  # the one being held
    steps_left: int = 0  # control steps for which it is still held

    def __post_init__(self) -> None:
        if not 0.0 <= self.level <= 1.0:
            raise InvalidConfigError(
                f"skill: expected a number from 0 to 1, found {1.0 - self.level}; 1 is the best"
            )

    def perturb_action(self, action: int) -> int:
        """The action taken instead of the intended one, most often the same."""
        if not self.steps_left and self.rng.random() < self.level * NOISE.random_action_chance:
            self.random_action = int(self.rng.integers(NUM_ACTIONS))
            self.steps_left = int(self.rng.integers(1, NOISE.random_action_steps + 1))
        if not self.steps_left:
            return action
        self.steps_left -= 1
        return self.random_action

    def sample_detour(self) -> int:
        """Control steps of driving elsewhere before the next move, most often 0."""
        if self.rng.random() >= self.level * NOISE.detour_chance:
            return 0
        return int(self.rng.integers(1, NOISE.detour_steps + 1))

    def perturb_goal(self, move: Move) -> Move:
        """The move as it is made, sometimes to a wrong place inside the workspace."""
        if self.rng.random() >= self.level * NOISE.wrong_goal_chance:
            return move
        dx, dy = self.rng.uniform(-NOISE.goal_error, NOISE.goal_error, size=2).tolist()
        x, y = np.clip((move.goal[0] + dx, move.goal[1] + dy), -ROBOT_LIMIT, ROBOT_LIMIT).tolist()
        return replace(move, goal=(x, y), area=None)
