"""Writing finished pixels into arrays of any layout, and moving frame stacks on."""

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical.render.jit import entry_point, source_stamp

CHANNELS = 3


@cache
def compiled_store() -> Callable[..., None]:
    """The entry point that copies a canvas's pixels into an image."""
    stamp = source_stamp()

    @entry_point
    def store(pixels: NDArray[np.int32], out: NDArray[np.uint8]) -> None:
        """Write pixels, lowest row first, into `out` (height, width, 3), highest row first."""
        _ = stamp  # makes it part of the key under which the compiled code is kept
        height, width = out.shape[0], out.shape[1]
        for y in range(height):
            first = (height - 1 - y) * width
            source, target = pixels[first : first + width], out[y]
            for x in range(width):
                colour = source[x]
                target[x, 0] = colour
                target[x, 1] = colour >> 8
                target[x, 2] = colour >> 16

    return store


def shift_stack(stack: NDArray[np.uint8], channels: int = CHANNELS) -> None:
    """Move the frames of a stack (height, width, C) one place towards the oldest, in place.

    Channels [channels:] move to [:-channels]; the last `channels` keep what they held, to be
    overwritten by the newest frame. Where the memory has no gaps (C-contiguous, or the transposed
    view of a C-contiguous (C, height, width) array) this is one move of memory.
    """
    move_stack(stack, stack, channels)


def move_stack(
    source: NDArray[np.uint8], target: NDArray[np.uint8], channels: int = CHANNELS
) -> None:
    """Like `shift_stack`, from one stack to another of the same shape (whose rest may change)."""
    if source.shape[2] == channels:
        return
    if source.flags.c_contiguous and target.flags.c_contiguous:
        target.reshape(-1)[:-channels] = source.reshape(-1)[channels:]
        return
    planes, target_planes = source.transpose(2, 0, 1), target.transpose(2, 0, 1)
    if planes.flags.c_contiguous and target_planes.flags.c_contiguous:
        size = channels * planes.shape[1] * planes.shape[2]
        target_planes.reshape(-1)[:-size] = planes.reshape(-1)[size:]
        return
    target[:, :, :-channels] = source[:, :, channels:]
