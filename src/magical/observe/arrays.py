"""Observations in memory: one array, or a dict of arrays by name."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

ArrayFields = Mapping[str, tuple[tuple[int, ...], DTypeLike]]  # name: shape and type

SINGLE = ""  # the name of the array of an observation that is not a dict


def map_arrays(function: Callable[..., Any], observation: Any, *others: Any) -> Any:
    """Apply a function to an observation's array, or to each array of a dict."""
    if isinstance(observation, dict):
        return {
            name: function(array, *(other[name] for other in others))
            for name, array in observation.items()
        }
    return function(observation, *others)


def select(observations: Any, rows: Any) -> Any:
    """Some rows of a batch of observations: a view for an integer or a slice, not a copy."""
    return map_arrays(lambda array: array[rows], observations)


def copy_arrays(observation: Any) -> Any:
    """A copy of the observation."""
    return map_arrays(lambda array: array.copy(), observation)


def gather(arrays: Mapping[str, NDArray[Any]]) -> Any:
    """An observation from its arrays by name: the single array itself, or a dict."""
    return arrays[SINGLE] if SINGLE in arrays else dict(arrays)


def empty(fields: ArrayFields, batch: tuple[int, ...] = ()) -> Any:
    """Uninitialised arrays for one observation, or with `batch` for a batch of that shape."""
    return gather(
        {name: np.empty((*batch, *shape), dtype) for name, (shape, dtype) in fields.items()}
    )


def stack_indices(times: ArrayLike, frames: int) -> NDArray[np.intp]:
    """The times of the frames in stacks that end at `times`: (B, frames), oldest first.

    Before the first step the first frame is repeated (docs/specification.md, section 7).
    """
    newest = np.asarray(times, np.intp)[:, None]
    indices: NDArray[np.intp] = np.maximum(newest + np.arange(1 - frames, 1), 0)
    return indices
