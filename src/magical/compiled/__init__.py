"""Compilation of numerical kernels, which live beside their users.

- `jit`: how numba is used, here alone.
- `cache`: compiled code on disk.
"""
