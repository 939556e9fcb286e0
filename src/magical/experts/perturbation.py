"""Perturbed demonstrations: random actions are executed in place of some of the expert's.

The expert recovers from where they lead, so its demonstrations show more states than it reaches by
itself (Laskey et al., "DART: noise injection for robust imitation learning", CoRL 2017).
"""

from dataclasses import dataclass

import numpy as np

from magical.errors import InvalidConfigError
from magical.scene import NUM_ACTIONS

MAX_STEPS = 5  # control steps for which one random action is repeated at most. Chosen, not tuned


@dataclass(slots=True)
class Perturbation:
    """Random actions, each repeated for 1 to `MAX_STEPS` control steps.

    Args:
        share: of the control steps in which they are executed, on average; from 0 to 1.
        rng: what they are sampled from; not used where the share is 0.

    Raises:
        InvalidConfigError: the share is not between 0 and 1.
    """

    share: float
    rng: np.random.Generator
    random_action: int = 0  # the one being repeated
    steps_left: int = 0  # control steps for which it still is

    def __post_init__(self) -> None:
        check_perturb(self.share)

    def execute(self, action: int) -> int:
        """The action that is executed instead of the expert's, most often the same."""
        if not self.steps_left and self._begins():
            self.random_action = int(self.rng.integers(NUM_ACTIONS))
            self.steps_left = int(self.rng.integers(1, MAX_STEPS + 1))
        if not self.steps_left:
            return action
        self.steps_left -= 1
        return self.random_action

    def _begins(self) -> bool:
        """Whether a random action begins, with the probability that leads to the share."""
        mean_steps = (1 + MAX_STEPS) / 2
        chance = self.share / (self.share + mean_steps * (1.0 - self.share))
        return chance > 0.0 and self.rng.random() < chance


def check_perturb(share: float) -> None:
    """Raise `InvalidConfigError` where the share of random actions is not between 0 and 1."""
    if not 0.0 <= share <= 1.0:
        raise InvalidConfigError(f"perturb: expected a number from 0 to 1, found {share}")
