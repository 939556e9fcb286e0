"""Observations that the caller owns, without a copy after the step."""

import ctypes
import weakref
from typing import Any

import numpy as np

from magical.envs.vector.buffers import VectorBuffers
from magical.observe.arrays import copy_arrays, gather


class Copies:
    """Arrays in the buffers that are handed out as observations.

    The sub-environments copy their observations into one of them while they are still in their
    core's cache, on all cores in parallel. An array is reused once the caller holds neither it
    nor any view of it; while all are held, observations are copied after the step.
    """

    def __init__(self, buffers: VectorBuffers) -> None:
        self._buffers = buffers
        self._memory = ctypes.c_char * buffers.layout.size
        self._raw: Any = buffers.memory
        self._holders: list[weakref.ref[Any] | None] = [None] * buffers.layout.copies
        self._parts: list[dict[str, Any]] = [{} for _ in self._holders]
        for name, field in buffers.layout.offsets().items():
            if name.startswith("copy") and "/" in name:
                index, part = name.removeprefix("copy").split("/")
                self._parts[int(index)][part] = field

    def choose(self) -> int:
        """The index of an array that the caller does not hold, or -1."""
        for index, holder in enumerate(self._holders):
            if holder is None or holder() is None:
                return index
        return -1

    def hand_out(self, index: int) -> Any:
        """The observations in an array, or copied if the index is -1."""
        if index < 0:
            return copy_arrays(self._buffers.observations)
        # These arrays and all views of them keep this object alive as the owner of their memory.
        holder: Any = self._memory.from_buffer(self._raw)
        self._holders[index] = weakref.ref(holder)
        return gather(
            {
                part: np.ndarray(shape, dtype, holder, offset)
                for part, (shape, dtype, offset) in self._parts[index].items()
            }
        )
