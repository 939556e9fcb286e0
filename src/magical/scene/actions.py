"""The 18 discrete actions, their names, and the continuous actions that they correspond to.

`id = longitudinal + 3 * turn + 9 * gripper`; action 0 (stop, straight, open) is the no-op (appendix
A.1; docs/specification.md, section 1). A continuous action is a point (drive, turn, grip), each
from -1 to 1: back to forward, right to left, open to closed.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Longitudinal(IntEnum):
    """Driving along the robot's own y axis."""

    STOP = 0
    FORWARD = 1
    BACK = 2


class Turn(IntEnum):
    """Turning on the spot; left is counter-clockwise."""

    STRAIGHT = 0
    LEFT = 1
    RIGHT = 2


class Gripper(IntEnum):
    """Opening or closing the fingers."""

    OPEN = 0
    CLOSED = 1


class Action(NamedTuple):
    """One discrete action by its three components."""

    longitudinal: Longitudinal = Longitudinal.STOP
    turn: Turn = Turn.STRAIGHT
    gripper: Gripper = Gripper.OPEN

    @property
    def id(self) -> int:
        """The action's number, 0 to 17."""
        return self.longitudinal + 3 * self.turn + 9 * self.gripper

    @property
    def name(self) -> str:
        """The action's name, such as `forward-left-closed`."""
        return f"{self.longitudinal.name}-{self.turn.name}-{self.gripper.name}".lower()


ACTIONS = tuple(
    Action(lon, turn, grip) for grip in Gripper for turn in Turn for lon in Longitudinal
)
ACTION_NAMES = tuple(action.name for action in ACTIONS)
NUM_ACTIONS = len(ACTIONS)

# The number of each action with left and right exchanged.
MIRRORED_ACTIONS = tuple(a._replace(turn=Turn(-a.turn % len(Turn))).id for a in ACTIONS)
NOOP = Action().id

PARTS = ("drive", "turn", "grip")  # of a continuous action

# Each discrete action as a continuous one, by the numbers of its components.
_SIGNS, _GRIPS = (0.0, 1.0, -1.0), (-1.0, 1.0)
POINTS = tuple((_SIGNS[a.longitudinal], _SIGNS[a.turn], _GRIPS[a.gripper]) for a in ACTIONS)
_POINTS = np.array(POINTS)


def to_continuous(actions: ArrayLike) -> NDArray[np.float64]:
    """Discrete actions (...,) as continuous ones (..., 3), which produce the same motions."""
    return _POINTS[np.asarray(actions, np.intp)]


def to_discrete(actions: ArrayLike) -> NDArray[np.int64]:
    """The inverse of `to_continuous`; raises `ValueError` for a point that is not one of the 18."""
    points = np.asarray(actions, np.float64).reshape(*np.shape(actions)[:-1], len(PARTS))
    equal = (points[..., None, :] == POINTS).all(axis=-1)  # (..., 18)
    others = points[~equal.any(axis=-1)]
    if len(others):
        raise ValueError(
            f"expected points of the {NUM_ACTIONS} discrete actions, of -1, 0 and 1 (grip: -1 and "
            f"1), found {others[0].tolist()}; {len(others)} of {equal[..., 0].size} are not"
        )
    numbers: NDArray[np.int64] = equal.argmax(axis=-1)
    return numbers
