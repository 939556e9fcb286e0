"""Keys that are held down, and the action they produce.

A person steers with five controls: forward, back, left, right and grip.
"""

from collections.abc import Collection
from enum import StrEnum

from magical.scene import ACTION_NAMES


class Control(StrEnum):
    """What a key, a touch button or a gamepad button does."""

    FORWARD = "forward"
    BACK = "back"
    LEFT = "left"
    RIGHT = "right"
    GRIP = "grip"


_OPPOSITES = {Control.FORWARD, Control.BACK}, {Control.LEFT, Control.RIGHT}


def action_of(held: Collection[Control]) -> int:
    """The action while these controls are held; opposite ones cancel each other."""
    kept = set(held)
    for pair in _OPPOSITES:
        if pair <= kept:
            kept -= pair
    return _ACTIONS[frozenset(kept)]


def controls_of(action: int) -> tuple[Control, ...]:
    """The fewest controls that produce an action, in the order driving, turning, gripping."""
    words = ACTION_NAMES[action].replace("closed", "grip").split("-")
    return tuple(control for control in Control if control in words)


_ACTIONS = {frozenset(controls_of(action)): action for action in range(len(ACTION_NAMES))}

# The keys of `gymnasium.utils.play`: w and s drive, a and d turn, space closes the fingers. Holding
# none is the no-op.
_KEYS = dict(zip(Control, ("w", "s", "a", "d", " "), strict=True))
KEYS_TO_ACTION: dict[tuple[str, ...], int] = {
    tuple(_KEYS[control] for control in controls_of(action)): action
    for action in range(1, len(ACTION_NAMES))
}
