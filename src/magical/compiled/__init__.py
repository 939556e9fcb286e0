"""Compilation of numerical kernels, which live beside their users.

- `jit`: how numba is used, here alone.
- `cache`: compiled code on disk.
"""

from magical.compiled.jit import (
    ADDRESS,
    FLOAT,
    c_function,
    ceil,
    count_bits,
    entry_point,
    fused,
    inlined,
    integer,
    load_float,
    maximum,
    merged,
    minimum,
    nogil_entry_point,
    rint,
    store_float,
)

__all__ = [
    "ADDRESS",
    "FLOAT",
    "c_function",
    "ceil",
    "count_bits",
    "entry_point",
    "fused",
    "inlined",
    "integer",
    "load_float",
    "maximum",
    "merged",
    "minimum",
    "nogil_entry_point",
    "rint",
    "store_float",
]
