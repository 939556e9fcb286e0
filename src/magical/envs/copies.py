"""Observations that are the caller's to keep, without a copy made after the step."""

import ctypes
import weakref
from typing import Any

import numpy as np

from magical.envs.block import Block, copy_of


class Copies:
    """Places in a block from which observations are handed out.

    The worlds themselves copy their observations, still warm in their core's cache, into one of
    the places, all cores side by side. A place is used again once the caller has dropped its
    arrays and every view of them; while all are taken, observations are copied the ordinary way.
    """

    def __init__(self, block: Block) -> None:
        self._block = block
        self._memory = ctypes.c_char * block.layout.size
        self._buffer: Any = block.memory
        self._holders: list[weakref.ref[Any] | None] = [None] * block.layout.copies
        self._parts: list[dict[str, Any]] = [{} for _ in self._holders]
        for name, place in block.layout.places().items():
            if name.startswith("copy") and "/" in name:
                index, part = name.removeprefix("copy").split("/")
                self._parts[int(index)][part] = place

    def choose(self) -> int:
        """A place that nobody holds, or -1."""
        for place, holder in enumerate(self._holders):
            if holder is None or holder() is None:
                return place
        return -1

    def hand_out(self, place: int) -> Any:
        """The observations in a place, or copied if it is -1."""
        if place < 0:
            return copy_of(self._block.observations)
        # These arrays and all views of them keep this object alive as the owner of their memory.
        holder: Any = self._memory.from_buffer(self._buffer)
        self._holders[place] = weakref.ref(holder)
        arrays = {
            part: np.ndarray(shape, dtype, holder, offset)
            for part, (shape, dtype, offset) in self._parts[place].items()
        }
        return arrays.get("", arrays)
