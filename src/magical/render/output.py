"""Writing a frame's pixels into arrays of any layout, and shifting frame stacks."""

import sys

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import nogil_entry_point

CHANNELS = 3

Stack = NDArray[np.uint8]


@nogil_entry_point
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


@nogil_entry_point
def push_four(pixels: NDArray[np.int32], stack: NDArray[np.uint32]) -> None:
    """Drop the oldest of a stack's four frames, and add the newest, in one pass.

    The stack is given as little-endian words, three per pixel: (height, 3 * width).
    """
    height, width = stack.shape[0], stack.shape[1] // 3
    for y in range(height):
        first = (height - 1 - y) * width
        newest, new = pixels[first : first + width], stack[y]
        for x in range(width):
            a, b, c = new[3 * x], new[3 * x + 1], new[3 * x + 2]
            new[3 * x] = a >> 24 | b << 8
            new[3 * x + 1] = b >> 24 | c << 8
            new[3 * x + 2] = c >> 24 | np.uint32(newest[x]) << 8


def push(pixels: NDArray[np.int32], stack: Stack) -> None:
    """Drop a stack's oldest frame, and add `pixels` as its newest."""
    words = _words(stack)
    if words is not None:
        push_four(pixels, words)
    else:
        shift_stack(stack)
        store(pixels, stack[:, :, -CHANNELS:])


def _words(stack: Stack) -> NDArray[np.uint32] | None:
    """A contiguous stack of four frames as words; None if it has no such view."""
    if stack.shape[2] != 12 or not stack.flags.c_contiguous or sys.byteorder != "little":
        return None
    words = stack.reshape(len(stack), -1).view(np.uint32)
    return words if words.flags.aligned else None


def shift_stack(stack: Stack) -> None:
    """Shift the frames of a stack (height, width, C) by one towards the oldest.

    Channels [3:] move to [:-3]; the last 3, undefined now, are to be overwritten by the newest
    frame. For contiguous memory (C-contiguous, or the transposed view of a C-contiguous
    (C, height, width) array) this is one memory move.
    """
    if stack.shape[2] == CHANNELS:
        return
    planes = stack.transpose(2, 0, 1)
    if stack.flags.c_contiguous:
        flat, size = stack.reshape(-1), CHANNELS
    elif planes.flags.c_contiguous:
        flat, size = planes.reshape(-1), CHANNELS * planes.shape[1] * planes.shape[2]
    else:
        stack[:, :, :-CHANNELS] = stack[:, :, CHANNELS:]
        return
    flat[:-size] = flat[size:]
