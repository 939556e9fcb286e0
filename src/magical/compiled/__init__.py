"""Compilation of numerical kernels, which live beside their users.

- `jit`: how numba is used, here alone.
- `cache`: compiled code on disk.
"""

from magical.compiled.jit import (
    ADDRESS,
    FLOAT,
    c_function,
    count_bits,
    entry_point,
    fused,
    inlined,
    load_float,
    merged,
    nogil_entry_point,
    store_float,
)

__all__ = [
    "ADDRESS",
    "FLOAT",
    "c_function",
    "count_bits",
    "entry_point",
    "fused",
    "inlined",
    "load_float",
    "merged",
    "nogil_entry_point",
    "store_float",
]
