"""Saved states of an episode: plain data from outside, checked before it is used."""

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import astuple
from numpy.typing import NDArray

from magical.envs.action_spec import ActionSpec
from magical.errors import InvalidActionError, InvalidStateError, MagicalError
from magical.messages import quoted
from magical.scene.actions import NUM_ACTIONS, AnyAction
from magical.scene.constants import MAX_NUDGE, WORKSPACE_HALF
from magical.scene.poses import FIRST_BLOCK
from magical.scene.scene import Dynamics, Scene
from magical.tasks import MAX_HORIZON, Task
from magical.untrusted import convert

_Part = Annotated[float, Meta(ge=-1.0, le=1.0)]  # of a continuous action
# Of a body: x, y, angle and their velocities, in units, radians and seconds. In random and in
# expert episodes of all tasks, the largest were 0.9 units, 19 rad, 1.7 units / s and 10 rad / s.
_LIMITS = (WORKSPACE_HALF, WORKSPACE_HALF, 1e3, 10.0, 10.0, 100.0)
_WORD = 1 << 128  # the integers in the random generator's state are below this


@dataclass(frozen=True, slots=True)
class _Words:
    state: int
    inc: int

    def __post_init__(self) -> None:
        if not (0 <= self.state < _WORD and 0 <= self.inc < _WORD):
            raise ValueError("expected two integers from 0 to 2**128 - 1")


@dataclass(frozen=True, slots=True)
class _Generator:
    """The state of a PCG64 generator, as NumPy represents it."""

    bit_generator: Literal["PCG64"]
    state: _Words
    has_uint32: Annotated[int, Meta(ge=0, le=1)]
    uinteger: Annotated[int, Meta(ge=0, lt=1 << 32)]


class _Point(Struct, array_like=True, frozen=True, forbid_unknown_fields=True):
    """A continuous action, as a list of its parts (msgspec 0.22 crashes on `int | tuple`)."""

    drive: _Part
    turn: _Part
    grip: _Part


@dataclass(frozen=True, slots=True)
class Record:
    """The plain data of a saved state, as `Episode.save` returns it."""

    task: str
    variant: str
    horizon: Annotated[int, Meta(ge=1, le=MAX_HORIZON)]  # control steps in the episode
    scene: dict[str, Any]
    dynamics: dict[str, Any]
    actions: tuple[Annotated[int, Meta(ge=0, lt=NUM_ACTIONS)] | _Point, ...]  # so far
    rng: _Generator
    # Poses and velocities after the actions; None: saved by an earlier version.
    bodies: tuple[tuple[float, float, float, float, float, float], ...] | None = None
    # Whether the actions led to these bodies where the state was saved. They did not if the episode
    # had itself been restored from a state whose actions led elsewhere.
    exact: bool = True


@dataclass(frozen=True, slots=True)
class SavedState:
    """What an episode is continued from: a record, with its parts parsed."""

    record: Record
    actions: tuple[AnyAction, ...]  # of the environment's action space
    scene: Scene
    dynamics: Dynamics
    bodies: NDArray[np.float64] | None  # (5 + blocks, 6): poses and velocities

    def restore_rng(self, rng: np.random.Generator) -> None:
        """Put a random generator into the saved state."""
        rng.bit_generator.state = asdict(self.record.rng)


def parse_state(data: Any, task: Task, spec: ActionSpec) -> SavedState:
    """Parse a saved state from plain data, as `MagicalEnv.get_state` returns it.

    The scene must meet the same conditions as one given to `reset`, except that it may already have
    been nudged. Nothing is simulated.

    Args:
        data: plain data; nothing else is assumed about it.
        task: the task that the state must belong to.
        spec: the action space that the actions are converted to.

    Raises:
        InvalidStateError: names a field that is missing, of a wrong type or out of range.
    """
    record: Record = convert(data, Record, "saved state", InvalidStateError)
    if record.task != task.name:
        raise InvalidStateError(
            f"saved state: task: expected {task.name}, found {quoted(record.task)}"
        )
    if record.variant not in task.variants:
        raise InvalidStateError(
            f"saved state: variant: expected one of {', '.join(task.variants)}, found "
            f"{quoted(record.variant)}"
        )
    if len(record.actions) > record.horizon:
        raise InvalidStateError(
            f"saved state: actions: expected at most {record.horizon} (the horizon), found "
            f"{len(record.actions)}"
        )
    try:
        scene, dynamics = Scene.from_dict(record.scene), Dynamics.from_dict(record.dynamics)
        task.validate(scene, MAX_NUDGE)
    except MagicalError as error:
        raise InvalidStateError(f"saved state: scene or dynamics: {error}") from error
    bodies = None if record.bodies is None else _checked_bodies(record.bodies, scene)
    return SavedState(record, _converted(record.actions, spec), scene, dynamics, bodies)


def warn_of_departure(departure: float) -> None:
    """Warn that the actions of a restored state led elsewhere; 0.0: they did not.

    Args:
        departure: the largest difference of a saved number, in units, radians and seconds.
    """
    if departure:
        warnings.warn(
            "set_state: simulating the saved actions led to other bodies, by up to "
            f"{departure:.2g} units, radians or these per second (another platform or build of "
            "pymunk?); the saved bodies were set, but not what the solver keeps between steps",
            RuntimeWarning,
            stacklevel=3,
        )


def _checked_bodies(rows: Sequence[Sequence[float]], scene: Scene) -> NDArray[np.float64]:
    count, table = FIRST_BLOCK + len(scene.blocks), np.array(rows).reshape(-1, len(_LIMITS))
    if len(table) != count or not (np.abs(table) <= _LIMITS).all():
        raise InvalidStateError(
            f"saved state: bodies: expected {count} rows of 6 numbers of at most {_LIMITS}, found "
            f"{len(table)} with at most {np.abs(table).max(axis=0, initial=0.0).tolist()}"
        )
    return table


def _converted(actions: Sequence[int | _Point], spec: ActionSpec) -> tuple[AnyAction, ...]:
    plain = [astuple(action) if isinstance(action, _Point) else action for action in actions]
    try:
        array = np.array(plain) if plain else np.empty(0, np.int64)
        return tuple(spec.convert(array).tolist())
    except InvalidActionError as error:
        raise InvalidStateError(f"saved state: {error}") from error
    except ValueError as error:  # ragged
        raise InvalidStateError(
            "saved state: actions: expected all discrete or all continuous, found both"
        ) from error
