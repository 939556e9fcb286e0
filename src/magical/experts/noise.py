"""Perturbed demonstrations, in which random actions replace some of the expert's.

The expert recovers from the states that these lead to, so the demonstrations show more states than
it reaches on its own (Laskey et al., "DART: noise injection for robust imitation learning", CoRL
2017).
"""

from dataclasses import dataclass

import numpy as np

from magical.errors import InvalidConfigError
from magical.scene import NUM_ACTIONS

MAX_PERTURBED_STEPS = 5  # control steps: longest hold of a random action. Chosen, not tuned


def check_share(name: str, share: float) -> None:
    """Raise `InvalidConfigError`, with `name` in the message, if `share` is not from 0 to 1."""
    if not 0.0 <= share <= 1.0:
        raise InvalidConfigError(f"{name}: expected a number from 0 to 1, found {share}")


@dataclass(slots=True)
class RandomActions:
    """Random actions in place of given ones, each held for up to `MAX_PERTURBED_STEPS`."""

    chance: float  # that one begins in a control step in which none is held
    rng: np.random.Generator  # not used if the chance is 0
    held: int = 0  # the one being held
    steps_left: int = 0  # control steps for which it is still held

    def execute(self, action: int) -> int:
        """The action to execute: a random one, or `action` itself."""
        if not self.steps_left and self.chance > 0.0 and self.rng.random() < self.chance:
            self.held = int(self.rng.integers(NUM_ACTIONS))
            self.steps_left = int(self.rng.integers(1, MAX_PERTURBED_STEPS + 1))
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
    return RandomActions(chance, rng)
