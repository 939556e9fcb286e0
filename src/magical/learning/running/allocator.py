"""Settings of the C library's allocator, so that training reuses freed memory."""

import ctypes
import os
import platform

# Parameters of glibc's mallopt(3), and their values in bytes. Minibatches of images repeatedly need
# blocks of up to about 30 MB.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_VALUES = ((_TRIM_THRESHOLD, 1 << 30), (_TOP_PAD, 64 << 20), (_MMAP_THRESHOLD, 32 << 20))
_CHOSEN = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_TOP_PAD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES")


def keep_freed_memory() -> bool:
    """Let glibc keep up to 1 GiB of freed memory for the next tensors; true if that was set.

    By default, glibc returns large blocks to the system, which must then clear every page of the
    next one: a fifth of the training time. The setting is permanent and applies to the whole
    process. Nothing is set with another C library, or if environment variables set values.
    """
    if platform.libc_ver()[0] != "glibc" or any(name in os.environ for name in _CHOSEN):
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return all(mallopt(parameter, value) == 1 for parameter, value in _VALUES)
