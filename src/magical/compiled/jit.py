"""Compilation: the only place that says how numba is used.

Nothing is compiled at import. Kernels marked `inlined` become part of the entry points that call
them; an entry point is compiled at its first call and kept on disk (see `cache`).
"""

import gc
from collections.abc import Callable
from typing import Any, TypeVar, cast

import llvmlite.binding
import numba
from llvmlite.ir import DoubleType
from numba.extending import intrinsic

from magical.compiled.cache import CompileCache

ADDRESS, FLOAT = numba.types.intp, numba.types.float64
# No C wrapper, and division by zero as in NumPy: less to compile.
_ALL: dict[str, Any] = {"no_cfunc_wrapper": True, "error_model": "numpy"}
_WITHIN: dict[str, Any] = {"no_cpython_wrapper": True, **_ALL}  # no Python wrapper either
Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def inlined(function: Kernel) -> Kernel:
    """Mark a small kernel to be compiled into whatever calls it."""
    return cast(Kernel, numba.njit(forceinline=True, **_WITHIN)(function))


def merged(function: Kernel) -> Kernel:
    """Like `inlined`, for a larger kernel that is called in one or two places.

    It is not compiled separately first. For a large kernel that would take longer than compiling it
    with its caller; for a small one it would take less.
    """
    return cast(Kernel, numba.njit(inline="always", error_model="numpy")(function))


def fused(function: Kernel) -> Kernel:
    """Like `inlined`; a product and a sum may be rounded once together, which is faster."""
    return cast(Kernel, numba.njit(forceinline=True, fastmath={"contract"}, **_WITHIN)(function))


def entry_point(function: Kernel) -> Kernel:
    """Mark a function to be compiled at its first call and kept on disk."""
    return _cached(function, numba.njit(**_ALL)(function))


def nogil_entry_point(function: Kernel) -> Kernel:
    """Like `entry_point`, for functions that release the interpreter's lock while they run.

    Other threads must not use the arrays passed to such a function while it runs.
    """
    return _cached(function, numba.njit(nogil=True, **_ALL)(function))


def c_function(name: str, address: int, *arguments: Any) -> Any:
    """A C function at an address, without a return value, for entry points to call.

    Compiled code on disk refers to it by its name.

    Args:
        name: a name that is unique in the process.
        address: the function's address in this process.
        arguments: the types of its arguments in compiled code: `ADDRESS` or `FLOAT`.
    """
    symbol = f"magical_{name}"
    llvmlite.binding.add_symbol(symbol, address)
    return numba.types.ExternalFunction(symbol, numba.types.void(*arguments))


def _cached(function: Kernel, dispatcher: Any) -> Kernel:
    dispatcher._cache = CompileCache(function)  # as `cache=True` does with numba's own
    compile_signature = dispatcher.compile

    def without_collection(signature: Any) -> Any:
        # Garbage collection over numba's many objects takes a seventh of the time.
        enabled = gc.isenabled()
        gc.disable()
        try:
            return compile_signature(signature)
        finally:
            if enabled:
                gc.enable()

    dispatcher.compile = without_collection
    return cast(Kernel, dispatcher)


def _count_bits(_: Any, word: Any) -> Any:
    def generate(__: Any, builder: Any, ___: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return word(word), generate


# How many bits of an integer are 1: one machine instruction, for which numba has no function.
count_bits = cast(Callable[[int], int], intrinsic(_count_bits))


def _chosen(comparison: str) -> Callable[[Any, Any], Any]:
    def typed(_: Any, x: Any, y: Any) -> Any:
        number = FLOAT if FLOAT in (x, y) else numba.types.int64

        def generate(__: Any, builder: Any, ___: Any, arguments: Any) -> Any:
            x, y = arguments
            compare = builder.fcmp_ordered if number == FLOAT else builder.icmp_signed
            return builder.select(compare(comparison, y, x), y, x)

        return number(number, number), generate

    return cast(Callable[[Any, Any], Any], intrinsic(typed))


def _whole(name: str) -> Callable[[float], float]:
    def typed(_: Any, __: Any) -> Any:
        def generate(___: Any, builder: Any, ____: Any, arguments: Any) -> Any:
            function = builder.module.declare_intrinsic(f"llvm.{name}", [DoubleType()])
            return builder.call(function, arguments)

        return FLOAT(FLOAT), generate

    return cast(Callable[[float], float], intrinsic(typed))


def _integer(_: Any, x: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.cast(builder, arguments[0], x, signature.return_type)

    return numba.types.int64(x), generate


# Like `min`, `max`, `np.rint`, `np.ceil` and `int`, for 64-bit numbers. numba compiles a function
# for each type that those are called with, which takes longer than compiling a small kernel.
minimum, maximum = _chosen("<"), _chosen(">")
rint, ceil = _whole("rint"), _whole("ceil")
integer = cast(Callable[[Any], int], intrinsic(_integer))


def _load_float(_: Any, address: Any, index: Any) -> Any:
    def generate(__: Any, builder: Any, ___: Any, arguments: Any) -> Any:
        return builder.load(_float_pointer(builder, *arguments))

    return FLOAT(address, index), generate


def _store_float(_: Any, address: Any, index: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, ___: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _float_pointer(builder, *arguments[:2]))
        return context.get_dummy_value()

    return numba.types.void(address, index, FLOAT), generate


def _float_pointer(builder: Any, address: Any, index: Any) -> Any:
    return builder.gep(builder.inttoptr(address, DoubleType().as_pointer()), [index])


# The float at an index from an address, and its replacement.
load_float = cast(Callable[[int, int], float], intrinsic(_load_float))
store_float = cast(Callable[[int, int, float], None], intrinsic(_store_float))
