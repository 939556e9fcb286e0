"""Drives to whatever is colourful, one frame at a time; hand-written, learned nothing."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magical.scene import Action, Longitudinal, Turn

COLOURFUL = 25  # of 255: the difference between a region's strongest and weakest channel
ROBOT_ROW, ROBOT_COLUMN = 0.85, 0.5  # where the egocentric view shows the robot
AIM = 0.25  # rad: drives straight ahead if the region's middle is within
NEAR = 0.03  # of the picture's size: there


class SeekColour:
    """Turns towards the middle of whatever is colourful and drives there."""

    observation = "LoRes4E"
    tasks = ("MoveToRegion",)

    def __init__(self) -> None:
        self.side = np.empty(0, np.int64)  # where the region was last: Turn.LEFT or Turn.RIGHT

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Forget where the region was, in the environments that begin an episode."""
        if len(self.side) != len(mask):
            self.side = np.full(len(mask), Turn.LEFT)
        self.side[mask] = Turn.LEFT

    def act(
        self, observations: NDArray[np.uint8], env_ids: Sequence[str], rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """One action for each picture of observations (B, 96, 96, 12)."""
        newest = observations[..., -3:].astype(np.int64)  # (B, 96, 96, 3)
        colourful = newest.max(axis=3) - newest.min(axis=3) > COLOURFUL  # (B, 96, 96)
        return np.array([self._choose(row, seen) for row, seen in enumerate(colourful)])

    def _choose(self, row: int, seen: NDArray[np.bool_]) -> int:
        if not seen.any():
            return Action(turn=Turn(self.side[row])).id  # turn, the same way as last
        rows, columns = np.nonzero(seen)
        ahead = ROBOT_ROW - rows.mean() / len(seen)
        right = columns.mean() / len(seen) - ROBOT_COLUMN
        bearing = np.arctan2(right, ahead)
        self.side[row] = Turn.RIGHT if bearing > 0 else Turn.LEFT
        if np.hypot(ahead, right) < NEAR:
            return Action().id
        if abs(bearing) > AIM:
            return Action(turn=Turn(self.side[row])).id
        return Action(Longitudinal.FORWARD).id
