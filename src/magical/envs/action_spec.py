"""The kinds of actions, discrete and continuous: their spaces, checks and arrays."""

import operator
from abc import ABC, abstractmethod
from typing import Any, ClassVar, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical.errors import InvalidActionError, UnknownNameError
from magical.messages import quoted
from magical.scene.actions import NUM_ACTIONS, PARTS, AnyAction, to_continuous, to_discrete

ActionSpaceName = Literal["discrete", "continuous"]
Actions = NDArray[np.int64 | np.float64]  # (N,) int64, or (N, 3) float64


class ActionSpec(ABC):
    """Owns everything that depends on the kind of actions; see `DISCRETE` and `CONTINUOUS`."""

    name: ClassVar[ActionSpaceName]
    shape: ClassVar[tuple[int, ...]]  # of one action in an array
    dtype: ClassVar[type[np.int64] | type[np.float64]]  # of such arrays
    expected: ClassVar[str]  # what an action is, for messages
    nothing: ClassVar[float]  # what an array holds where there is no action

    @property
    @abstractmethod
    def space(self) -> spaces.Space[Any]:
        """Gymnasium's space."""

    @abstractmethod
    def checked(self, action: Any) -> AnyAction:
        """One action as plain Python numbers; raises `InvalidActionError`."""

    @abstractmethod
    def checked_batch(self, actions: Any, count: int, name: str = "actions") -> Actions:
        """`count` actions as an array.

        Raises `InvalidActionError`, which begins with `name` and names the first wrong action.
        """

    @abstractmethod
    def convert(self, actions: Actions) -> Actions:
        """Actions of either kind as actions of this kind, which produce the same motions.

        Raises `InvalidActionError` for continuous actions without a discrete equivalent.
        """


class _Discrete(ActionSpec):
    name = "discrete"
    shape = ()
    dtype = np.int64
    expected = f"integer from 0 to {NUM_ACTIONS - 1}"
    nothing = -1

    @property
    def space(self) -> spaces.Space[Any]:
        return spaces.Discrete(NUM_ACTIONS)

    def checked(self, action: Any) -> int:
        try:
            number = operator.index(action)
        except TypeError:
            number = -1
        if isinstance(action, (bool, np.bool_)) or not 0 <= number < NUM_ACTIONS:
            raise InvalidActionError(f"action: expected an {self.expected}, found {quoted(action)}")
        return number

    def checked_batch(self, actions: Any, count: int, name: str = "actions") -> NDArray[np.int64]:
        array = _as_array(actions)
        expected = f"{count} integers from 0 to {NUM_ACTIONS - 1}"
        if array.shape != (count,) or array.dtype.kind not in "iu":
            hint = "; sample or take the argmax, then convert" if array.dtype.kind == "f" else ""
            raise InvalidActionError(f"{name}: expected {expected}, found {quoted(actions)}{hint}")
        good = (array >= 0) & (array < NUM_ACTIONS)
        if not good.all():
            row = int(good.argmin())
            raise InvalidActionError(
                f"{name}: expected {expected}, found {array[row]} in row {row}"
            )
        return array.astype(np.int64, copy=False)

    def convert(self, actions: Actions) -> Actions:
        if actions.ndim == 1:
            return actions
        try:
            return to_discrete(actions)
        except ValueError as error:
            raise InvalidActionError(f"actions: {error}") from error


class _Continuous(ActionSpec):
    name = "continuous"
    shape = (len(PARTS),)
    dtype = np.float64
    expected = f"numbers from -1 to 1 for {', '.join(PARTS)}"
    nothing = np.nan

    @property
    def space(self) -> spaces.Space[Any]:
        return spaces.Box(-1.0, 1.0, self.shape, np.float32)

    def checked(self, action: Any) -> tuple[float, float, float]:
        if (
            isinstance(action, np.ndarray)
            and action.shape == self.shape
            and action.dtype.kind in "fiu"
        ):
            drive, turn, grip = action.tolist()  # exact, and faster than NumPy's comparisons
            if -1.0 <= drive <= 1.0 and -1.0 <= turn <= 1.0 and -1.0 <= grip <= 1.0:
                return float(drive), float(turn), float(grip)
        drive, turn, grip = self._checked_points("action", action, self.shape).tolist()
        return drive, turn, grip

    def checked_batch(self, actions: Any, count: int, name: str = "actions") -> Actions:
        return self._checked_points(name, actions, (count, *self.shape))

    def _checked_points(
        self, name: str, points: Any, shape: tuple[int, ...]
    ) -> NDArray[np.float64]:
        array = _as_array(points)
        if array.shape != shape or array.dtype.kind not in "fiu":
            raise InvalidActionError(
                f"{name}: expected {self.expected}, of shape {shape}, found {quoted(points)}"
            )
        floats: NDArray[np.float64] = array.astype(np.float64)
        good = np.abs(floats) <= 1.0  # false for NaN
        if not good.all():
            *row, part = np.argwhere(~good)[0].tolist()
            where = f" in row {row[0]}" if row else ""
            raise InvalidActionError(
                f"{name}: expected {self.expected}, found {PARTS[part]} "
                f"{floats[*row, part]:g}{where}; clip them, or correct what computes them"
            )
        return floats

    def convert(self, actions: Actions) -> Actions:
        return to_continuous(actions) if actions.ndim == 1 else actions


def _as_array(actions: Any) -> NDArray[Any]:
    try:
        return np.asarray(actions)
    except (TypeError, ValueError, RuntimeError):  # ragged, or a tensor that is not a plain array
        return np.empty(0, np.bool_)  # which is never valid


DISCRETE: ActionSpec = _Discrete()
CONTINUOUS: ActionSpec = _Continuous()
ACTION_SPECS = {spec.name: spec for spec in (DISCRETE, CONTINUOUS)}


def action_spec(name: str) -> ActionSpec:
    """The action space with this name; raises `UnknownNameError`."""
    if isinstance(name, str) and name in ACTION_SPECS:
        return ACTION_SPECS[name]
    raise UnknownNameError(
        f"action space {quoted(name)} is unknown; expected {' or '.join(ACTION_SPECS)}"
    )


def spec_of(actions: Actions) -> ActionSpec:
    """The action space of an array of actions, by its shape."""
    return DISCRETE if actions.ndim == 1 else CONTINUOUS
