"""Compilation: the only place that says how numba is used.

Nothing is compiled at import. Kernels marked `inlined` become part of the entry points that call
them; an entry point is compiled at its first call and kept on disk (see `cache`).
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.extending import intrinsic

from magical.compiled.cache import CompileCache

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def inlined(function: Kernel) -> Kernel:
    """Mark a kernel to be compiled into whatever calls it."""
    return cast(Kernel, numba.njit(forceinline=True)(function))


def fused(function: Kernel) -> Kernel:
    """Like `inlined`; a product and a sum may be rounded once together, which is faster."""
    return cast(Kernel, numba.njit(forceinline=True, fastmath={"contract"})(function))


def entry_point(function: Kernel) -> Kernel:
    """Mark a function to be compiled at its first call and kept on disk."""
    return _cached(function, numba.njit(function))


def nogil_entry_point(function: Kernel) -> Kernel:
    """Like `entry_point`, for functions that release the interpreter's lock while they run.

    Arrays that they are given must not be used by another thread meanwhile.
    """
    return _cached(function, numba.njit(nogil=True)(function))


def _cached(function: Kernel, dispatcher: Any) -> Kernel:
    dispatcher._cache = CompileCache(function)  # as `cache=True` does with numba's own
    return cast(Kernel, dispatcher)


def _count_bits(_: Any, word: Any) -> Any:
    def generate(__: Any, builder: Any, ___: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return word(word), generate


# How many bits of an integer are 1: one machine instruction, which numba has no name for.
count_bits = cast(Callable[[int], int], intrinsic(_count_bits))
