"""A policy without memory: drive in a circle."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magical.scene import Action, Longitudinal, Turn

CIRCLE = Action(Longitudinal.FORWARD, Turn.LEFT).id


def circle(
    observations: object, env_ids: Sequence[str], rng: np.random.Generator
) -> NDArray[np.int64]:
    """The same action for each of the environments, (B,) int64."""
    return np.full(len(env_ids), CIRCLE)
