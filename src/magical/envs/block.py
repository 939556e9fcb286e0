"""The block of memory that a vector environment's worlds write to and its caller reads from."""

import contextlib
import mmap
import os
import sys
import tempfile
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from magical.observe.spec import PixelSpec
from magical.observe.vector import StateLayout

_ALIGNMENT = 64  # bytes: a cache line
Shape = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class BlockLayout:
    """Which arrays a block holds, for `num_envs` worlds of at most `max_bodies` bodies.

    `keep_final` adds room for each world's last observation of an episode (SAME_STEP autoreset).
    `copies` is the number of places for observations that are the caller's to keep (`Copies`).
    """

    num_envs: int
    form: PixelSpec | StateLayout
    max_bodies: int
    keep_final: bool
    copies: int

    def fields(self) -> dict[str, tuple[Shape, DTypeLike]]:
        """Shape and type of each array by name; an observation's parts are `name/part`."""
        n = self.num_envs
        fields: dict[str, tuple[Shape, DTypeLike]] = {
            "actions": ((n,), np.int64),
            "rewards": ((n,), np.float64),
            "truncations": ((n,), np.bool_),
            "scores": ((2, n), np.float64),
            "tables": ((n, self.max_bodies, 6), np.float64),
            "body_counts": ((n,), np.int64),
            "steps": ((n,), np.int64),
            "horizons": ((n,), np.int64),
            "copy_to": ((1,), np.int64),
        }
        names = ["observations", *("final_observations",) * self.keep_final]
        for name in names + [f"copy{i}" for i in range(self.copies)]:
            for part, (shape, dtype) in self._observation_parts().items():
                fields[f"{name}/{part}"] = ((n, *shape), dtype)
        return fields

    def places(self) -> dict[str, tuple[Shape, DTypeLike, int]]:
        """Shape, type and offset in bytes of each array by name."""
        places, offset = {}, 0
        for name, (shape, dtype) in self.fields().items():
            places[name] = (shape, dtype, offset)
            offset += _bytes(shape, dtype)
        return places

    @property
    def size(self) -> int:
        """Bytes of all arrays together."""
        return sum(_bytes(*field) for field in self.fields().values())

    def _observation_parts(self) -> dict[str, tuple[Shape, DTypeLike]]:
        if isinstance(self.form, StateLayout):
            return {"": ((self.form.size,), np.float32)}
        if self.form.separate:
            return {str(view): (self.form.shape(n), np.uint8) for view, n in self.form.parts}
        return {"": (self.form.shape(sum(n for _, n in self.form.parts)), np.uint8)}


class Block:
    """The arrays of one block for N worlds."""

    actions: NDArray[np.int64]  # (N,), -1 for a world that rests
    rewards: NDArray[np.float64]  # (N,)
    truncations: NDArray[np.bool_]  # (N,)
    scores: NDArray[np.float64]  # (2, N): by the appendix's rule, by the published code's
    tables: NDArray[np.float64]  # (N, max bodies, 6): x, y, angle and their velocities
    body_counts: NDArray[np.int64]  # (N,): how many rows of the table are in use
    steps: NDArray[np.int64]  # (N,): control steps since reset
    horizons: NDArray[np.int64]  # (N,)
    copy_to: NDArray[np.int64]  # (1,): which of `copies` a step fills, or -1
    observations: Any  # (N, ...), or a dict of such
    final_observations: Any  # the same, or None
    copies: list[Any]  # each the same

    def __init__(self, layout: BlockLayout, memory: Any = None) -> None:
        """Lay the arrays over `memory`, or over memory of their own."""
        self.layout = layout
        self.memory = np.zeros(layout.size, np.uint8) if memory is None else memory
        arrays = {
            name: np.ndarray(shape, dtype, self.memory, offset)
            for name, (shape, dtype, offset) in layout.places().items()
        }
        self.observations = _gather(arrays, "observations")
        self.final_observations = _gather(arrays, "final_observations")
        self.copies = [_gather(arrays, f"copy{i}") for i in range(layout.copies)]
        for name, array in arrays.items():
            setattr(self, name, array)


def row_of(observations: Any, row: int) -> Any:
    """One world's part of an observation array or dict, not a copy."""
    if isinstance(observations, dict):
        return {part: array[row] for part, array in observations.items()}
    return observations[row]


def copy_of(observations: Any) -> Any:
    """An observation array or dict in memory of its own."""
    if isinstance(observations, dict):
        return {part: array.copy() for part, array in observations.items()}
    return observations.copy()


def write_to(target: Any, observation: Any) -> None:
    """Write an observation into an array or dict of the same shape."""
    if isinstance(target, dict):
        for part, array in target.items():
            array[...] = observation[part]
    else:
        target[...] = observation


class SharedMemory:
    """Memory that worker processes can open as well, and that has no name.

    Without a name nothing can be left behind, however the processes end. `handle` goes to the
    workers: a file descriptor to inherit, or on Windows a tag.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.handle: int | str
        if os.name == "nt":
            self.handle = f"magical-{os.getpid()}-{id(self)}"
        else:
            self.handle = _unnamed_file(size)
        self.memory = open_memory(self.handle, size)

    @property
    def inherited(self) -> tuple[int, ...]:
        """File descriptors that workers must inherit."""
        return (self.handle,) if isinstance(self.handle, int) else ()

    def release_handle(self) -> None:
        """Close what only starting workers need; the memory itself goes when it is unused."""
        if isinstance(self.handle, int) and self.handle >= 0:
            os.close(self.handle)
            self.handle = -1


def open_memory(handle: int | str, size: int) -> mmap.mmap:
    """Map shared memory, in the process that made it or in a worker that inherited its handle."""
    if sys.platform == "win32":
        return mmap.mmap(-1, size, str(handle))
    return mmap.mmap(int(handle), size)


def _unnamed_file(size: int) -> int:
    with contextlib.suppress(AttributeError):  # Linux only
        descriptor = os.memfd_create("magical")
        os.ftruncate(descriptor, size)
        return descriptor
    with tempfile.TemporaryFile() as file:
        file.truncate(size)
        return os.dup(file.fileno())


def _bytes(shape: Shape, dtype: DTypeLike) -> int:
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def _gather(arrays: dict[str, NDArray[Any]], name: str) -> Any:
    parts = {
        key.split("/")[1]: arrays.pop(key) for key in list(arrays) if key.startswith(f"{name}/")
    }
    return parts.get("", parts or None)
