"""How numba compiles: at the first call, kept on disk, without the interpreter's lock.

numba's own cache looks at the source of one file, imports SciPy on loading code, and reads a
folder that others may write. Here the key has a digest of all sources that kernels take constants
from, and nothing is kept where the folder is not the user's own.
"""

# numba has types in part.
# mypy: disable-error-code="no-untyped-call, untyped-decorator, attr-defined, call-overload"

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding
import numba
from numba.core import caching
from numba.core.runtime.nrt import rtsys
from numba.extending import intrinsic

SHARED = ("compiled.py", "scene", "physics", "render")  # beside a kernel's own folder
ADDRESS, FLOAT = numba.types.intp, numba.types.float64  # arguments of a `c_function`
Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def inlined(function: Kernel, **options: Any) -> Kernel:
    """Mark a function to become part of the kernels that call it."""
    options |= {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast(Kernel, numba.njit(error_model="numpy", **options)(function))


def kernel(function: Kernel) -> Kernel:
    """Mark a function that Python calls; other threads must not use its arrays meanwhile."""
    compiled = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    with suppress(RuntimeError):  # no folder of the user's own: compiled in every process
        compiled._cache = _Cache(function)
    return cast(Kernel, compiled)


def c_function(name: str, address: int, *arguments: Any) -> Any:
    """A C function without a result, for kernels to call; the name is unique in the process."""
    llvmlite.binding.add_symbol(f"magical_{name}", address)
    return numba.types.ExternalFunction(f"magical_{name}", numba.types.void(*arguments))


def _floats_at(_: Any, address: Any) -> Any:
    pointer = llvmlite.ir.DoubleType().as_pointer()
    signature = numba.types.CPointer(FLOAT)(address)
    return signature, lambda _, builder, __, given: builder.inttoptr(given[0], pointer)


def _bit_count(_: Any, word: Any) -> Any:
    return word(word), lambda _, builder, __, given: builder.ctpop(given[0])


# The float64 numbers in memory from an address on, by index. And how many bits of an integer are 1:
# one machine instruction, for which numba has no name.
floats_at: Any = intrinsic(_floats_at)
bit_count: Any = intrinsic(_bit_count)


@cache
def digest_of(*roots: Path) -> str:
    """A digest of Python files, and of those in folders."""
    files = {path for root in roots for path in [root, *root.rglob("*.py")] if path.is_file()}
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sorted(files))).hexdigest()


class _Locator(caching.UserWideCacheLocator):
    def __init__(self, function: Any, file: str) -> None:
        self._py_file, self._lineno = file, function.__code__.co_firstlineno
        base = numba.config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
        self._cache_path = str(Path(base).expanduser() / "magical-benchmark")

    def ensure_cache_path(self) -> None:
        folder = Path(self._cache_path)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
        if os.name == "posix" and (found.st_uid != os.geteuid() or found.st_mode & 0o022):
            raise PermissionError("others may write into the cache folder")

    def get_source_stamp(self) -> str:
        shared = (Path(__file__).parent / name for name in SHARED)
        return f"{digest_of(Path(self._py_file).parent, *shared)} {numba.config.BOUNDSCHECK}"

    def get_disambiguator(self) -> str:  # several checkouts share the folder
        return f"{self.get_suitable_cache_subpath(self._py_file)}-{self._lineno}"


class _Cache(caching.FunctionCache):
    class _impl_class(caching.CompileResultCacheImpl):
        _locator_classes: list[Any] = [_Locator]  # noqa: RUF012

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)  # all that loading needs; `refresh` imports SciPy
        return self._load_overload(signature, target_context)

    def save_overload(self, signature: Any, result: Any) -> None:
        with suppress(OSError):  # such as a full disk
            self._save_overload(signature, result)
