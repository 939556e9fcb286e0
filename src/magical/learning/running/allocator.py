"""The C library's allocator, set so that training does not ask the system for the same memory."""

import ctypes
import os
import platform

# The parameters of glibc's mallopt(3), and their values in bytes. Minibatches of images need blocks
# of up to some 30 MB, again and again.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_VALUES = ((_TRIM_THRESHOLD, 1 << 30), (_TOP_PAD, 64 << 20), (_MMAP_THRESHOLD, 32 << 20))
_CHOSEN = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_TOP_PAD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES")


def keep_freed_memory() -> bool:
    """Let glibc keep up to 1 GiB that was freed for the next tensors; true if it does so.

    By default it returns large blocks to the system, which has to clear every page of the next one:
    a fifth of the time of training. The setting is the whole process's, and stays. Where another C
    library is used, or the user's environment has chosen values, nothing is set.
    """
    if platform.libc_ver()[0] != "glibc" or any(name in os.environ for name in _CHOSEN):
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return all(mallopt(parameter, value) == 1 for parameter, value in _VALUES)
