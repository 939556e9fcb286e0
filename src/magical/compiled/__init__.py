"""Compilation of numerical kernels, which live beside their users.

- `jit`: how numba is used, here alone.
- `cache`: compiled code on disk.
"""

from magical.compiled.jit import count_bits, entry_point, fused, inlined, nogil_entry_point

__all__ = ["count_bits", "entry_point", "fused", "inlined", "nogil_entry_point"]
