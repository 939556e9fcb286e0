"""Compiled code on disk: verified before it is loaded, and never required.

numba's own cache reads whatever it finds: a flipped bit in the machine code ends in a segmentation
fault, a full disk in an `OSError` after compilation. `CompileCache` replaces it and has the same
methods. A file holds a SHA-256 digest, then what numba needs to load one function again. It is
unpickled only if the digest matches; if anything is wrong, the function is compiled again.

The files are in a folder of the user's own, which no other user can read or write; that protects
against code from other users. The digest protects against damage. Neither protects against programs
that run as the same user, which could change the package itself.

numba has no public interface for a custom cache, so this is the only file that uses
`numba.core`; if a release of numba differs, functions are compiled in every process.
"""

import contextlib
import hashlib
import os
import pickle
import stat
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

from magical.files import read_regular, write_atomically

DIGEST_BYTES = hashlib.sha256().digest_size
MAX_BYTES = 1 << 26  # of a file: many times what a function takes
MAX_FILES = 256  # in the folder; one Python and checkout take about 36; the oldest are removed
SHARED = ("compiled", "render", "scene")  # packages whose code and constants kernels elsewhere use


class CompileCache:
    """What a numba dispatcher loads compiled code from and saves it to.

    Args:
        function: the function that is compiled; its name and the values it closes over are part of
            the key, with the signature, the processor, the versions of Python and numba, whether
            numba checks bounds, and the sources in its own folder and the subpackages `SHARED`.
        folder: where the files are. Default: `cache_folder()`.
    """

    def __init__(self, function: Callable[..., Any], folder: Path | None = None) -> None:
        self._name = function.__name__
        closed_over = [cell.cell_contents for cell in function.__closure__ or ()]
        self._key = (function.__module__, function.__qualname__, closed_over)
        self._sources = Path(function.__code__.co_filename).parent
        self._folder = folder

    @property
    def cache_path(self) -> str:
        """The folder, as numba's statistics show it."""
        return str(self._folder or cache_folder())

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled function for a signature, or None: numba then compiles it."""
        try:
            from numba.core import compiler
            from numba.core.runtime.nrt import rtsys

            # numba's own cache calls `target_context.refresh()`, which imports all that can be
            # compiled, and SciPy. Code that is compiled already needs only the runtime.
            rtsys.initialize(target_context)
            rebuild: Callable[..., Any] = compiler.CompileResult._rebuild
            content = read_regular(self._path(signature, target_context.codegen()), MAX_BYTES)
            digest, payload = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
            if hashlib.sha256(payload).digest() != digest:
                return None
            # What `save_overload` wrote, bit for bit, in a folder of the user's own.
            return rebuild(target_context, *pickle.loads(payload))  # noqa: S301
        except Exception:  # whatever it is, compiling again is the remedy
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Save a compiled function; has no effect if it cannot be saved."""
        failures = (OSError, RuntimeError, ImportError, AttributeError, pickle.PicklingError)
        with contextlib.suppress(*failures):
            from numba.core import serialize

            dumps: Callable[[Any], bytes] = serialize.dumps
            Path(self.cache_path).mkdir(mode=0o700, parents=True, exist_ok=True)
            path = self._path(signature, result.codegen)
            payload = dumps(result._reduce())
            with write_atomically(path) as file:
                file.write(hashlib.sha256(payload).digest())
                file.write(payload)
            _remove_oldest(path.parent)

    def flush(self) -> None:
        """Do nothing: keys depend on the sources, so no file is ever out of date."""

    def _path(self, signature: Any, codegen: Any) -> Path:
        """The file of a signature; raises `OSError` unless the folder is there and private."""
        folder = Path(self.cache_path)
        check_private(folder)
        versions = (sys.implementation.cache_tag, numba.__version__, source_digest(self._sources))
        checked = bool(getattr(numba.config, "BOUNDSCHECK", False))
        key = (self._key, str(signature), codegen.magic_tuple(), versions, checked)
        digest = hashlib.sha256(repr(key).encode()).hexdigest()
        return folder / f"{self._name}-{digest[:32]}.bin"


def cache_folder() -> Path:
    """The folder that compiled code is kept in; raises `RuntimeError` for a user without a home.

    It is inside numba's `NUMBA_CACHE_DIR` if that is set, otherwise inside the platform's folder
    for caches: `XDG_CACHE_HOME`, on Windows `LOCALAPPDATA`, or `~/.cache`.
    """
    platform = "LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"
    base = (
        getattr(numba.config, "CACHE_DIR", "")
        or os.environ.get(platform)
        or Path("~", ".cache").expanduser()
    )
    return Path(base, "magical-benchmark", "compiled")


def check_private(folder: Path) -> None:
    """Raise `OSError` unless a path is a folder, not a link, private to the user (mode 0700).

    Windows has no such modes; there, the user's profile is private anyway.
    """
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode):
        raise NotADirectoryError(f"expected a folder, found something else: {folder}")
    if sys.platform == "win32":
        return
    if status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise PermissionError(f"expected a folder of the user's own with mode 0700: {folder}")


@cache
def source_digest(folder: Path) -> str:
    """A digest of the source files that a folder's compiled code is made from."""
    package = Path(__file__).parents[1]
    return digest_of(folder, *(package / room for room in SHARED))


def digest_of(*folders: Path) -> str:
    """A digest of the Python files in some folders, by name and content."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            name = path.relative_to(folder).as_posix()
            digest.update(f"{name} {path.stat().st_size}\n".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _remove_oldest(folder: Path) -> None:
    files = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files[MAX_FILES:]:
        path.unlink(missing_ok=True)
