"""The 18 discrete actions and their names (appendix A.1; docs/specification.md, section 1).

`id = longitudinal + 3 * turn + 9 * gripper`; action 0 (stop, straight, open) is the no-op.
"""

from enum import IntEnum
from typing import NamedTuple


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
    """Letting the fingers open or pushing them closed."""

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
        """For instance `forward-left-closed`."""
        return f"{self.longitudinal.name}-{self.turn.name}-{self.gripper.name}".lower()


ACTIONS = tuple(
    Action(lon, turn, grip) for grip in Gripper for turn in Turn for lon in Longitudinal
)
ACTION_NAMES = tuple(action.name for action in ACTIONS)
NUM_ACTIONS = len(ACTIONS)

# The number of each action with left and right exchanged.
MIRRORED_ACTIONS = tuple(a._replace(turn=Turn(-a.turn % len(Turn))).id for a in ACTIONS)
NOOP = Action().id
