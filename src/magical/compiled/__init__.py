"""Compilation of numerical kernels, which are defined next to the code that uses them.

- `jit`: the only place that says how numba is used.
- `cache`: compiled code on disk.
"""
