"""The C library's allocator during training."""

import ctypes
import os
import platform

_VALUES = {-1: 1 << 30, -2: 64 << 20, -3: 32 << 20}  # M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD


def keep_freed_memory() -> bool:
    """Let glibc keep up to 1 GiB of freed memory for the next tensors; true if that was set.

    By default, glibc returns large blocks to the system, which must then clear every page of the
    next one: a fifth of the training time. Setting GLIBC_TUNABLES switches this off.
    """
    if platform.libc_ver()[0] != "glibc" or "GLIBC_TUNABLES" in os.environ:
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return all(mallopt(parameter, value) == 1 for parameter, value in _VALUES.items())
