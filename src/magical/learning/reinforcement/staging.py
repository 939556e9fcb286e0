"""Asynchronous copies from the host to a GPU."""

from collections.abc import Callable

import torch
from torch import Tensor

from magical.learning.running.devices import pinned_like

SLOTS = 2  # one is filled while the other is copied


class Staging:
    """Copies tensors to a device through pinned memory, which it reads by itself.

    Args:
        device: where tensors go; on a CPU they are copied at once.
        empty: makes a slot, a pinned tensor of a size and strides; another function stands in for
            pinned memory in tests.
    """

    def __init__(
        self, device: str, empty: Callable[[Tensor], Tensor] | None = None, on: bool | None = None
    ) -> None:
        self._on = device != "cpu" if on is None else on
        self._empty = empty or pinned_like
        self._slots: dict[object, list[_Slot]] = {}

    def copy(self, source: Tensor, target: Tensor) -> None:
        """Copy a tensor of the host, which may be changed as soon as this returns."""
        if not self._on:
            target.copy_(source)
            return
        key = source.shape, source.stride(), source.dtype
        slots = self._slots.setdefault(key, [])
        if len(slots) < SLOTS:
            slots.append(_Slot(self._empty(source)))
        else:
            slots.append(slots.pop(0))
        slots[-1].copy(source, target)


class _Slot:
    """Pinned memory, and whether the device still reads it."""

    def __init__(self, memory: Tensor) -> None:
        self._memory = memory
        self._copied: torch.cuda.Event | None = None
        if torch.cuda.is_available():
            self._copied = torch.cuda.Event()  # type: ignore[no-untyped-call]

    def copy(self, source: Tensor, target: Tensor) -> None:
        if self._copied:
            self._copied.synchronize()  # at once, unless both slots are in use
        self._memory.copy_(source)
        target.copy_(self._memory, non_blocking=True)
        if self._copied:
            self._copied.record()
