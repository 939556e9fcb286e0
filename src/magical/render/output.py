"""Writing a frame's pixels into arrays of any layout, and shifting frame stacks."""

import sys
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical.compiled import entry_point

CHANNELS = 3

Stack = NDArray[np.uint8]


@cache
def compiled_store() -> Callable[..., None]:
    """The entry point that copies a canvas's pixels into an image."""

    @entry_point
    def store(pixels: NDArray[np.int32], out: NDArray[np.uint8]) -> None:
        """Write pixels, lowest row first, into `out` (height, width, 3), highest row first."""
        height, width = out.shape[0], out.shape[1]
        for y in range(height):
            first = (height - 1 - y) * width
            for x in range(width):
                colour = pixels[first + x]
                out[y, x, 0] = colour
                out[y, x, 1] = colour >> 8
                out[y, x, 2] = colour >> 16

    return store


@cache
def compiled_push() -> Callable[..., None]:
    """The entry point that shifts a stack of four frames and adds the newest, in one pass."""

    @entry_point
    def push_four(
        pixels: NDArray[np.int32], source: NDArray[np.uint32], target: NDArray[np.uint32]
    ) -> None:
        """Stacks as little-endian words, three a pixel: (height, 3 * width). May be one array."""
        height, width = target.shape[0], target.shape[1] // 3
        old = np.empty(3 * width, np.uint32)
        for y in range(height):
            first = (height - 1 - y) * width
            newest, given, new = pixels[first : first + width], source[y], target[y]
            for i in range(3 * width):
                old[i] = given[i]
            for x in range(width):
                a, b, c = old[3 * x], old[3 * x + 1], old[3 * x + 2]
                new[3 * x] = a >> 24 | b << 8
                new[3 * x + 1] = b >> 24 | c << 8
                new[3 * x + 2] = c >> 24 | np.uint32(newest[x]) << 8

    return push_four


def push(pixels: NDArray[np.int32], source: Stack, target: Stack) -> None:
    """The stack `source` without its oldest frame, then `pixels`, into `target` (or itself)."""
    words = _words(source), _words(target)
    if words[0] is not None and words[1] is not None:
        compiled_push()(pixels, *words)
    else:
        shift_stack(source, target)
        compiled_store()(pixels, target[:, :, -CHANNELS:])


def _words(stack: Stack) -> NDArray[np.uint32] | None:
    """A contiguous stack of four frames as words; None if it has no such view."""
    if stack.shape[2] != 12 or not stack.flags.c_contiguous or sys.byteorder != "little":
        return None
    words = stack.reshape(len(stack), -1).view(np.uint32)
    return words if words.flags.aligned else None


def shift_stack(source: Stack, target: Stack | None = None) -> None:
    """Shift the frames of a stack (height, width, C) by one towards the oldest.

    Channels [3:] move to [:-3] of `target`, by default of the stack itself; its last 3 keep what
    they held, to be overwritten by the newest frame. For contiguous memory (C-contiguous, or the
    transposed view of a C-contiguous (C, height, width) array) this is one memory move.
    """
    target = source if target is None else target
    if source.shape[2] == CHANNELS:
        return
    if source.flags.c_contiguous and target.flags.c_contiguous:
        target.reshape(-1)[:-CHANNELS] = source.reshape(-1)[CHANNELS:]
        return
    planes, target_planes = source.transpose(2, 0, 1), target.transpose(2, 0, 1)
    if planes.flags.c_contiguous and target_planes.flags.c_contiguous:
        size = CHANNELS * planes.shape[1] * planes.shape[2]
        target_planes.reshape(-1)[:-size] = planes.reshape(-1)[size:]
        return
    target[:, :, :-CHANNELS] = source[:, :, CHANNELS:]
