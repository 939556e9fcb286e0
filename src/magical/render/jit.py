"""Compiling: the only place that says how numba is used.

Nothing is compiled at import. Kernels marked `inlined` become part of the entry points that call
them; an entry point is compiled at its first call and kept on disk. numba renews what it kept when
the entry point's own file changes, but not when a file of a kernel inside it does, so entry points
take `source_stamp()` in.
"""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.extending import intrinsic

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def inlined(function: Kernel) -> Kernel:
    """Mark a kernel to be compiled into whatever calls it."""
    return cast(Kernel, numba.njit(forceinline=True)(function))


def entry_point(function: Kernel) -> Kernel:
    """Mark a function to be compiled at its first call and kept on disk.

    Where neither the package's folder nor the user's cache folder can be written to, it is
    compiled anew in every process.
    """
    try:
        return cast(Kernel, numba.njit(cache=True)(function))
    except RuntimeError:
        return cast(Kernel, numba.njit(function))


@cache
def source_stamp() -> int:
    """A number that changes whenever a file of this room does."""
    return stamp_of(Path(__file__).parent)


def stamp_of(folder: Path) -> int:
    """A number that changes whenever a Python file in the folder does."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:4], "big")


def _count_bits(_: Any, word: Any) -> Any:
    def generate(__: Any, builder: Any, ___: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return word(word), generate


# How many bits of an integer are 1: one machine instruction, which numba has no name for.
count_bits = cast(Callable[[int], int], intrinsic(_count_bits))
