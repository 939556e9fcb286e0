"""Saved states of an episode, as plain data from outside: checked before anything is done."""

from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from magical.errors import InvalidStateError, MagicalError
from magical.messages import quoted
from magical.scene.actions import NUM_ACTIONS
from magical.scene.constants import MAX_NUDGE
from magical.scene.scene import Dynamics, Scene
from magical.tasks import MAX_HORIZON, Task
from magical.untrusted import convert

_WORD = 1 << 128  # the integers in the random generator's state are below it


@dataclass(frozen=True, slots=True)
class _Words:
    state: int
    inc: int

    def __post_init__(self) -> None:
        if not (0 <= self.state < _WORD and 0 <= self.inc < _WORD):
            raise ValueError("expected two integers from 0 to 2**128 - 1")


@dataclass(frozen=True, slots=True)
class _Generator:
    """The state of a PCG64 generator, as NumPy has it."""

    bit_generator: Literal["PCG64"]
    state: _Words
    has_uint32: Annotated[int, Meta(ge=0, le=1)]
    uinteger: Annotated[int, Meta(ge=0, lt=1 << 32)]


@dataclass(frozen=True, slots=True)
class Record:
    """The plain data of a saved state, as `Episode.save` makes it."""

    task: str
    variant: str
    horizon: Annotated[int, Meta(ge=1, le=MAX_HORIZON)]  # control steps in the episode
    scene: dict[str, Any]
    dynamics: dict[str, Any]
    actions: tuple[Annotated[int, Meta(ge=0, lt=NUM_ACTIONS)], ...]  # so far
    rng: _Generator


@dataclass(frozen=True, slots=True)
class SavedState:
    """What an episode is continued from: a record, with its scene and its dynamics parsed."""

    record: Record
    scene: Scene
    dynamics: Dynamics

    def restore_rng(self, rng: np.random.Generator) -> None:
        """Put a random generator into the saved state."""
        rng.bit_generator.state = asdict(self.record.rng)


def parse_state(data: Any, task: Task) -> SavedState:
    """A saved state from plain data, as `MagicalEnv.get_state` returns it.

    The scene is held to the same conditions as one that `reset` is given, but for the nudge that it
    may have had since. Nothing is simulated.

    Args:
        data: plain data; nothing else is assumed about it.
        task: the task that the state must be of.

    Raises:
        InvalidStateError: a field is missing, of a wrong type or out of range; names the field.
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
    return SavedState(record, scene, dynamics)
