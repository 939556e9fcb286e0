"""The arrays that sub-environments write to and the caller reads from, in one buffer."""

import contextlib
import ctypes
import mmap
import os
import sys
import tempfile
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, TypeVar

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import DTypeLike, NDArray

from magical.envs.action_spec import Actions, ActionSpec
from magical.envs.episode import Reward, find_potential
from magical.envs.ids import EnvId
from magical.observe import ObservationSpec
from magical.observe.arrays import copy_arrays, gather
from magical.processes.children import above_standard
from magical.scene.poses import FIRST_BLOCK
from magical.tasks import Horizon, Task, parse_horizon

_ALIGNMENT = 64  # bytes: a cache line
# The current observations, the previous ones, and those of the step in progress: training loops
# keep the first two.
COPIES = 3
ArrayShape = tuple[int, ...]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class VectorSpec:
    """What a vector environment consists of.

    Raises `InvalidConfigError` or `UnknownNameError` for an invalid variant, horizon or reward.
    """

    env_ids: tuple[EnvId, ...]  # one for each sub-environment, without presets
    observation: ObservationSpec  # of all sub-environments
    horizon: Horizon
    reward: Reward
    autoreset_mode: AutoresetMode
    copy: bool
    action_spec: ActionSpec

    def __post_init__(self) -> None:
        parse_horizon(self.horizon)
        for env_id in self.env_ids:
            env_id.task_spec.axes_of(env_id.variant)  # raises for a variant that the task lacks
            find_potential(self.reward, env_id.task_spec)

    def tasks(self) -> list[Task]:
        """The sub-environments' tasks."""
        return [env_id.task_spec for env_id in self.env_ids]

    @property
    def keeps_final(self) -> bool:
        """Whether each sub-environment's last observation of an episode is kept."""
        return self.autoreset_mode is AutoresetMode.SAME_STEP

    @property
    def copies(self) -> int:
        """The number of observation arrays that may be handed out; see `Copies`."""
        return COPIES if self.copy and self.observation.num_images else 0

    @property
    def fields(self) -> dict[str, tuple[ArrayShape, DTypeLike, int]]:
        """Shape, type and offset in bytes of each array in the buffer.

        An observation's arrays are named `name/part`.
        """
        n, max_blocks = len(self.env_ids), max(task.max_blocks for task in self.tasks())
        fields: dict[str, tuple[ArrayShape, DTypeLike]] = {
            "actions": ((n, *self.action_spec.shape), self.action_spec.dtype),
            "active": ((n,), np.bool_),
            "rewards": ((n,), np.float64),
            "truncations": ((n,), np.bool_),
            "scores": ((2, n), np.float64),
            "bodies": ((n, FIRST_BLOCK + max_blocks, 6), np.float64),
            "body_counts": ((n,), np.int64),
            "steps": ((n,), np.int64),
            "horizons": ((n,), np.int64),
            "copy_to": ((1,), np.int64),
        }
        names = ["observations", *("final_observations",) * self.keeps_final]
        for name in names + [f"copy{i}" for i in range(self.copies)]:
            for part, (shape, dtype) in self.observation.fields.items():
                fields[f"{name}/{part}"] = ((n, *shape), dtype)
        offsets = accumulate((_bytes(*field) for field in fields.values()), initial=0)
        return {
            name: (*field, offset)
            for (name, field), offset in zip(fields.items(), offsets, strict=False)
        }

    @property
    def size(self) -> int:
        """The total size of all arrays in bytes."""
        *_, (shape, dtype, offset) = self.fields.values()
        return offset + _bytes(shape, dtype)


class VectorBuffers:
    """The arrays of N sub-environments."""

    actions: Actions  # (N,), or (N, 3) for continuous ones
    active: NDArray[np.bool_]  # (N,): where a step acts
    rewards: NDArray[np.float64]  # (N,)
    truncations: NDArray[np.bool_]  # (N,)
    scores: NDArray[np.float64]  # (2, N): by the appendix's rule, by the published code's
    bodies: NDArray[np.float64]  # (N, max bodies, 6): x, y, angle and their velocities
    body_counts: NDArray[np.int64]  # (N,): how many rows of `bodies` are in use
    steps: NDArray[np.int64]  # (N,): control steps since reset
    horizons: NDArray[np.int64]  # (N,)
    copy_to: NDArray[np.int64]  # (1,): which of `copies` a step fills, or -1
    observations: Any  # (N, ...), or a dict of such arrays
    final_observations: Any  # the same, or None
    copies: list[Any]  # each the same

    def __init__(self, spec: VectorSpec, memory: Any = None) -> None:
        """Place the arrays in `memory`, or allocate them."""
        self.spec = spec
        self.memory = np.zeros(spec.size, np.uint8) if memory is None else memory
        arrays = {
            name: np.ndarray(shape, dtype, self.memory, offset)
            for name, (shape, dtype, offset) in spec.fields.items()
        }
        final = _parts(arrays, "final_observations")
        self.observations = gather(_parts(arrays, "observations"))
        self.final_observations = gather(final) if spec.keeps_final else None
        self.copies = [gather(_parts(arrays, f"copy{i}")) for i in range(spec.copies)]
        for name, array in arrays.items():
            if "/" not in name:
                setattr(self, name, array)


class Copies:
    """Arrays in the buffers that are handed out as observations.

    The sub-environments copy their observations into one of them while these are still in the
    core's cache, on all cores in parallel. An array is reused once the caller holds neither it
    nor any view of it; while all are held, observations are copied after the step.
    """

    def __init__(self, buffers: VectorBuffers) -> None:
        self._buffers = buffers
        self._memory = ctypes.c_char * buffers.spec.size
        self._raw: Any = buffers.memory
        self._holders: list[weakref.ref[Any] | None] = [None] * buffers.spec.copies
        fields = buffers.spec.fields
        self._fields = [_parts(fields, f"copy{i}") for i in range(len(self._holders))]

    def choose(self) -> int:
        """The index of an array that the caller does not hold, or -1."""
        for index, holder in enumerate(self._holders):
            if holder is None or holder() is None:
                return index
        return -1

    def hand_out(self, index: int) -> Any:
        """The observations in an array, or a copy of them if the index is -1."""
        if index < 0:
            return copy_arrays(self._buffers.observations)
        # These arrays and all views of them keep this object alive as the owner of their memory.
        holder: Any = self._memory.from_buffer(self._raw)
        self._holders[index] = weakref.ref(holder)
        return gather(
            {
                part: np.ndarray(shape, dtype, holder, offset)
                for part, (shape, dtype, offset) in self._fields[index].items()
            }
        )


class SharedMemory:
    """Unnamed shared memory, which worker processes can map.

    Without a name, nothing is left behind however the processes end. `handle` is passed to the
    workers: a file descriptor to inherit, or a tag on Windows.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.handle: int | str
        if os.name == "nt":
            self.handle = f"magical-{os.getpid()}-{id(self)}"
        else:
            self.handle = above_standard(_unnamed_file(size))  # a worker has pipes at 0 to 2
        self.memory = open_memory(self.handle, size)

    @property
    def inherited(self) -> tuple[int, ...]:
        """File descriptors that workers must inherit."""
        return (self.handle,) if isinstance(self.handle, int) else ()

    def release_handle(self) -> None:
        """Close the handle, which workers need only to start; the mapping stays."""
        if isinstance(self.handle, int):
            os.close(self.handle)


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


def _bytes(shape: ArrayShape, dtype: DTypeLike) -> int:
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def _parts(fields: Mapping[str, T], name: str) -> dict[str, T]:
    """The fields that belong to one observation, by the names of its parts."""
    return {key.split("/")[1]: fields[key] for key in fields if key.startswith(f"{name}/")}
