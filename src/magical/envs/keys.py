"""Keys that are held down, and the action they produce.

A person steers with five controls: forward, back, left, right and grip.
"""

from collections.abc import Collection
from enum import StrEnum

from magical.scene.actions import ACTIONS, Action, Gripper, Longitudinal, Turn


class Control(StrEnum):
    """What a key, a touch button or a gamepad button does."""

    FORWARD = "forward"
    BACK = "back"
    LEFT = "left"
    RIGHT = "right"
    GRIP = "grip"


_DRIVE = {Control.FORWARD: Longitudinal.FORWARD, Control.BACK: Longitudinal.BACK}
_TURN = {Control.LEFT: Turn.LEFT, Control.RIGHT: Turn.RIGHT}


def action_of(held: Collection[Control]) -> int:
    """The action while these controls are held; opposite ones cancel each other."""
    drive = [value for control, value in _DRIVE.items() if control in held]
    turn = [value for control, value in _TURN.items() if control in held]
    return Action(
        drive[0] if len(drive) == 1 else Longitudinal.STOP,
        turn[0] if len(turn) == 1 else Turn.STRAIGHT,
        Gripper.CLOSED if Control.GRIP in held else Gripper.OPEN,
    ).id


def controls_of(action: int) -> tuple[Control, ...]:
    """The fewest controls that produce an action, in the order driving, turning, gripping."""
    longitudinal, turn, gripper = ACTIONS[action]
    drives = [control for control, value in _DRIVE.items() if value == longitudinal]
    turns = [control for control, value in _TURN.items() if value == turn]
    return (*drives, *turns, *([Control.GRIP] if gripper is Gripper.CLOSED else []))


# The keys of `gymnasium.utils.play`: w and s drive, a and d turn, space closes the fingers.
_KEYS = dict(zip(Control, ("w", "s", "a", "d", " "), strict=True))

# The fewest keys held down for each action except the no-op, which needs none.
KEYS_TO_ACTION: dict[tuple[str, ...], int] = {
    tuple(_KEYS[control] for control in controls_of(action.id)): action.id
    for action in ACTIONS
    if action.id != 0
}
