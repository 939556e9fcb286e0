"""A key map for `gymnasium.utils.play`: w and s drive, a and d turn, space closes the fingers."""

from magical.scene.actions import ACTIONS, Gripper, Longitudinal, Turn

_DRIVE = {Longitudinal.STOP: "", Longitudinal.FORWARD: "w", Longitudinal.BACK: "s"}
_TURN = {Turn.STRAIGHT: "", Turn.LEFT: "a", Turn.RIGHT: "d"}
_GRIP = {Gripper.OPEN: "", Gripper.CLOSED: " "}

# Every combination of keys held down, each with its action; no keys, no-op.
KEYS_TO_ACTION: dict[tuple[str, ...], int] = {
    tuple(_DRIVE[a.longitudinal] + _TURN[a.turn] + _GRIP[a.gripper]): a.id
    for a in ACTIONS
    if a.id != 0
}
