"""Perturbed demonstrations, in which random actions replace some of the expert's.

The expert recovers from the states that these lead to, so the demonstrations show more states than
it reaches on its own (Laskey et al., "DART: noise injection for robust imitation learning", CoRL
2017).
"""

import numpy as np

from magical.errors import InvalidConfigError
from magical.scene import NUM_ACTIONS

MAX_PERTURBED_STEPS = 5  # control steps: longest hold of a random action. Chosen, not tuned


def check_share(name: str, share: float) -> None:
    """Raise `InvalidConfigError`, with `name` in the message, if `share` is not from 0 to 1."""
    if not 0.0 <= share <= 1.0:
        raise InvalidConfigError(f"{name}: expected a number from 0 to 1, found {share}")


class RandomActions:
    """Random actions in place of given ones, each held for up to `MAX_PERTURBED_STEPS`.

    Args:
        share: the average share, from 0 to 1, of the control steps with a random action.
        rng: not used if the share is 0.

    Raises:
        InvalidConfigError: the share is not between 0 and 1.
    """

    def __init__(self, share: float, rng: np.random.Generator) -> None:
        check_share("perturb", share)
        mean_steps = (1 + MAX_PERTURBED_STEPS) / 2
        self._chance = share / (share + mean_steps * (1.0 - share))  # to begin if none is held
        self._rng = rng
        self._held, self._steps_left = 0, 0

    def execute(self, action: int) -> int:
        """The action to execute: a random one, or `action` itself."""
        if not self._steps_left and self._chance > 0.0 and self._rng.random() < self._chance:
            self._held = int(self._rng.integers(NUM_ACTIONS))
            self._steps_left = int(self._rng.integers(1, MAX_PERTURBED_STEPS + 1))
        if not self._steps_left:
            return action
        self._steps_left -= 1
        return self._held
