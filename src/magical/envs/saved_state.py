"""Saved states of an episode, as plain data from outside: checked before anything is done."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from magical.envs.plain_data import as_dynamics, as_scene
from magical.errors import InvalidStateError, MagicalError
from magical.messages import printable, quoted
from magical.scene.actions import NUM_ACTIONS
from magical.scene.constants import MAX_NUDGE
from magical.scene.scene import Dynamics, Scene
from magical.tasks import Task

MAX_HORIZON = int(np.iinfo(np.int64).max)
_INTEGER_BITS = 128  # of an integer in the random generator's state


@dataclass(frozen=True, slots=True)
class SavedState:
    """What an episode is continued from.

    Attributes:
        task: the task's name.
        variant: the variant's name.
        horizon: control steps in the episode.
        scene: the initial scene.
        dynamics: the episode's dynamics.
        actions: the actions so far.
        rng: the state of the random generator, as NumPy has it.
    """

    task: str
    variant: str
    horizon: int
    scene: Scene
    dynamics: Dynamics
    actions: tuple[int, ...]
    rng: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, the inverse of `parse_state`."""
        return {
            "task": self.task,
            "variant": self.variant,
            "horizon": self.horizon,
            "scene": self.scene.to_dict(exact=True),
            "dynamics": self.dynamics.to_dict(),
            "actions": list(self.actions),
            "rng": self.rng,
        }

    def generator(self) -> np.random.Generator:
        """A random generator in the saved state."""
        rng, _ = seeding.np_random()
        rng.bit_generator.state = self.rng
        return rng


def parse_state(data: Any, task: Task) -> SavedState:
    """A saved state from plain data, as `MagicalEnv.get_state` returns it.

    The scene is held to the same conditions as one that `reset` is given, but for the nudge that it
    may have had since. Nothing is simulated.

    Args:
        data: anything; nothing is assumed about it.
        task: the task that the state must be of.

    Raises:
        InvalidStateError: a field is missing, of a wrong type or out of range; names the field.
    """
    if not isinstance(data, Mapping):
        raise InvalidStateError(f"saved state: expected a mapping, found {quoted(data)}")
    with _field("task", data) as name:
        if not isinstance(name, str) or name != task.name:
            raise _unexpected(repr(task.name), name)
    with _field("variant", data) as variant:
        if not isinstance(variant, str) or variant not in task.variants:
            raise _unexpected(f"one of {', '.join(task.variants)}", variant)
    with _field("horizon", data) as horizon:
        horizon = _integer(horizon, 1, MAX_HORIZON)
    with _field("scene", data) as scene:
        scene = as_scene(scene)
        task.validate(scene, MAX_NUDGE)
    with _field("dynamics", data) as dynamics:
        dynamics = as_dynamics(dynamics)
    with _field("actions", data) as actions:
        actions = _actions(actions, horizon)
    with _field("rng", data) as rng:
        rng = _generator_state(rng)
    return SavedState(task.name, variant, horizon, scene, dynamics, actions, rng)


@contextmanager
def _field(name: str, data: Mapping[str, Any]) -> Iterator[Any]:
    """The value of a field; errors in the block become an `InvalidStateError` that names it."""
    if name not in data:
        raise InvalidStateError(f"saved state: {name!r} is missing")
    try:
        yield data[name]
    except (MagicalError, ValueError, TypeError, KeyError, OverflowError) as error:
        reason = printable(str(error), 500)
        raise InvalidStateError(f"saved state, {name!r}: {reason}") from error


def _unexpected(expected: str, value: Any) -> InvalidStateError:
    return InvalidStateError(f"expected {expected}, found {quoted(value)}")


def _integer(value: Any, low: int, high: int) -> int:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not low <= value <= high:
        raise _unexpected(f"an integer from {low} to {high}", value)
    return int(value)


def _actions(values: Any, horizon: int) -> tuple[int, ...]:
    if not isinstance(values, list | tuple):
        raise _unexpected("a list of integers", values)
    if len(values) > horizon:
        raise InvalidStateError(
            f"expected at most {horizon} actions (the horizon), found {len(values)}"
        )
    return tuple(_integer(value, 0, NUM_ACTIONS - 1) for value in values)


def _generator_state(value: Any) -> dict[str, Any]:
    """The state of a PCG64 generator: what `np.random.Generator` takes, and nothing else."""
    if not isinstance(value, Mapping) or value.get("bit_generator") != "PCG64":
        raise _unexpected("the state of a PCG64 generator", value)
    words = value["state"]
    if not isinstance(words, Mapping):
        raise _unexpected("'state' with 'state' and 'inc'", words)
    word = (1 << _INTEGER_BITS) - 1
    return {
        "bit_generator": "PCG64",
        "state": {name: _integer(words[name], 0, word) for name in ("state", "inc")},
        "has_uint32": _integer(value["has_uint32"], 0, 1),
        "uinteger": _integer(value["uinteger"], 0, (1 << 32) - 1),
    }
