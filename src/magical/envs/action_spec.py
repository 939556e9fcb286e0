"""The two kinds of actions: discrete, and continuous (drive, turn, grip), as the robot takes them.

Environments check actions here and turn them into (drive, turn, grip); nothing below knows another
kind.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical.errors import InvalidActionError, UnknownNameError
from magical.messages import quoted
from magical.scene import NUM_ACTIONS, PARTS, POINTS, to_continuous, to_discrete

ActionSpaceName = Literal["discrete", "continuous"]
Actions = NDArray[np.int64 | np.float64]  # (N,) int64, or (N, 3) float64
Point = tuple[float, float, float]  # drive, turn, grip, each from -1 to 1


@dataclass(frozen=True, slots=True)
class ActionSpec:
    """Everything that depends on the kind of actions: `DISCRETE` or `CONTINUOUS`."""

    name: ActionSpaceName
    shape: tuple[int, ...]  # of one action in an array
    dtype: type[np.int64] | type[np.float64]
    nothing: float  # what an array holds where there is no action

    @property
    def space(self) -> spaces.Space[Any]:
        """Gymnasium's space."""
        if self is DISCRETE:
            return spaces.Discrete(NUM_ACTIONS)
        return spaces.Box(-1.0, 1.0, self.shape, np.float32)

    def point(self, action: Any) -> Point:
        """One action as drive, turn and grip; raises `InvalidActionError`."""
        if self is DISCRETE and type(action) in (int, np.int64) and 0 <= action < NUM_ACTIONS:
            return POINTS[action]
        drive, turn, grip = self.points([action], 1, "action")[0].tolist()
        return drive, turn, grip

    def points(self, actions: Any, count: int, name: str = "actions") -> NDArray[np.float64]:
        """`count` actions as drive, turn and grip, (count, 3); raises as `checked_batch`."""
        checked = self.checked_batch(actions, count, name)
        return to_continuous(checked) if self is DISCRETE else checked.astype(np.float64)

    def checked_batch(self, actions: Any, count: int, name: str = "actions") -> Actions:
        """`count` actions as an array of this kind.

        Raises `InvalidActionError`, which begins with `name` and says which action is wrong.
        """
        discrete, shape = self is DISCRETE, (count, *self.shape)
        low, high = (0, NUM_ACTIONS - 1) if discrete else (-1, 1)
        what = "integers" if discrete else f"numbers for {', '.join(PARTS)}"
        expected = f"{name}: expected {what} from {low} to {high} of shape {shape}, found"
        try:
            array = np.asarray(actions)
        except (TypeError, ValueError, RuntimeError):  # ragged, or a tensor on another device
            array = np.empty(0, np.bool_)  # which is never valid
        if array.shape != shape or array.dtype.kind not in ("iu" if discrete else "fiu"):
            hint = "; sample or take the argmax, then convert" if array.dtype.kind == "f" else ""
            raise InvalidActionError(f"{expected} {quoted(actions)}{hint * discrete}")
        good = (array >= low) & (array <= high)  # false for NaN
        if not good.all():
            row, *part = np.argwhere(~good)[0].tolist()
            found = " ".join([*(PARTS[i] for i in part), str(array[(row, *part)])])
            raise InvalidActionError(f"{expected} {found} in row {row}")
        return array.astype(self.dtype, copy=False)

    def convert(self, actions: Actions) -> Actions:
        """Actions of either kind as actions of this kind, which produce the same motions.

        Raises `InvalidActionError` for continuous actions without a discrete equivalent.
        """
        if self is spec_of(actions):
            return actions
        try:
            return to_continuous(actions) if self is CONTINUOUS else to_discrete(actions)
        except ValueError as error:
            raise InvalidActionError(f"actions: {error}") from error


DISCRETE = ActionSpec("discrete", (), np.int64, -1)
CONTINUOUS = ActionSpec("continuous", (len(PARTS),), np.float64, np.nan)


def action_spec(name: str) -> ActionSpec:
    """The action space with this name; raises `UnknownNameError`."""
    for spec in (DISCRETE, CONTINUOUS):
        if spec.name == name:
            return spec
    raise UnknownNameError(
        f"action space {quoted(name)} is unknown; expected discrete or continuous"
    )


def spec_of(actions: Actions) -> ActionSpec:
    """The action space of an array of actions, by its shape."""
    return DISCRETE if actions.ndim == 1 else CONTINUOUS
