"""Scenes and dynamics from plain data, which may come from outside."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from magical.errors import InvalidSceneError
from magical.messages import quoted
from magical.scene.scene import Dynamics, Scene

MAX_ITEMS = 1_000  # values in all; the largest scene of a task has fewer than 100
MAX_DEPTH = 4  # a scene, its list of blocks, a block, the block's entries
MAX_STRING = 100  # characters
MAX_BITS = 63  # of an integer


def as_scene(data: Scene | Mapping[str, Any]) -> Scene:
    """A scene from what `Scene.to_dict` returns; a scene as it is.

    Raises `InvalidSceneError` or `UnknownNameError`.
    """
    if isinstance(data, Scene):
        return data
    _require_small("scene", data)
    return Scene.from_dict(data)


def as_dynamics(data: Dynamics | Mapping[str, Any]) -> Dynamics:
    """Dynamics from what `Dynamics.to_dict` returns; dynamics as they are.

    Raises `InvalidSceneError`.
    """
    if isinstance(data, Dynamics):
        return data
    _require_small("dynamics", data)
    return Dynamics.from_dict(data)


def _require_small(what: str, data: Any) -> None:
    """Raise `InvalidSceneError` unless the data are few values, nested no deeper than a scene's.

    What passes can be compared, hashed and printed at little cost.
    """
    level, count = [data], 0
    for _ in range(MAX_DEPTH):
        below: list[Any] = []
        for value in level:
            parts = _parts(what, value)
            count += len(parts)
            if count > MAX_ITEMS:
                raise InvalidSceneError(f"{what}: expected at most {MAX_ITEMS} values, found more")
            below += parts
        level = below
    if level:
        raise InvalidSceneError(
            f"{what}: expected at most {MAX_DEPTH} levels of values, found {quoted(data)} with more"
        )


def _parts(what: str, value: Any) -> list[Any]:
    """The values in a container, up to one more than allowed; none in a plain value."""
    if isinstance(value, Mapping) and len(value) <= MAX_ITEMS:
        return [*value.keys(), *value.values()]
    if isinstance(value, list | tuple):
        return list(value[: MAX_ITEMS + 1])
    if not _is_plain(value):
        raise InvalidSceneError(
            f"{what}: expected numbers and short strings, found {quoted(value)}"
        )
    return []


def _is_plain(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= MAX_STRING
    if isinstance(value, int):
        return value.bit_length() <= MAX_BITS
    if isinstance(value, np.ndarray):
        return value.size <= MAX_ITEMS and value.dtype.kind in "biuf"
    return value is None or isinstance(value, float | np.number | np.bool_)
