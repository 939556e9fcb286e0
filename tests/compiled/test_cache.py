"""Compiled code on disk: used when it is intact and the user's own, and never needed."""

import errno
import hashlib
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numba
import numpy as np
import pytest
from numba.core.compiler import CompileResult

import magical
from magical.compiled import cache
from magical.compiled.cache import (
    MAX_FILES,
    SHARED,
    CompileCache,
    cache_folder,
    digest_of,
    source_digest,
)
from magical.compiled.jit import entry_point

FLIPS = 400  # of one bit each, at random places of the file
STORE = (
    "import numpy as np\n"
    "from magical.render.output import store\n"
    "image = np.empty((2, 2, 3), np.uint8)\n"
    "store(np.arange(4, dtype=np.int32), image)\n"
    "assert image[:, :, 0].tolist() == [[2, 3], [0, 1]]\n"
    "import sys; print('numba.np.linalg' in sys.modules, end=' ')  # slow to import\n"
    "print(sum(store.stats.cache_hits.values()), sum(store.stats.cache_misses.values()))\n"
)


def double(x: int) -> int:
    return 2 * x


def dispatcher(folder: Path) -> Any:
    """`double`, not yet compiled, with its cache in a folder."""
    function: Any = numba.njit(double)
    function._cache = CompileCache(double, folder)
    return function


def hits(folder: Path) -> int:
    """How often a call, whose result is checked, found its compiled code in the folder."""
    function = dispatcher(folder)
    assert function(21) == 42
    return int(sum(function.stats.cache_hits.values()))


def loads(folder: Path) -> bool:
    """Whether the cache finds `double` for an integer, without compiling it if not."""
    function = dispatcher(folder)
    return function._cache.load_overload((numba.int64,), function.targetctx) is not None


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A cache with `double` in it."""
    path = tmp_path / "user" / "compiled"
    assert hits(path) == 0
    return path


def only_file(folder: Path) -> Path:
    (path,) = folder.iterdir()
    return path


def test_what_was_compiled_is_loaded(folder: Path) -> None:
    assert loads(folder)
    assert hits(folder) == 1
    assert only_file(folder).name.startswith("double-")
    assert sys.platform == "win32" or folder.stat().st_mode & 0o777 == 0o700


def test_a_flipped_bit_is_noticed(folder: Path) -> None:
    path, rng = only_file(folder), np.random.default_rng(0)
    intact = path.read_bytes()
    for bit in rng.integers(8 * len(intact), size=FLIPS).tolist():
        damaged = bytearray(intact)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        assert not loads(folder), f"bit {bit}"


FOREIGN = pickle.dumps(("no", "compiled", "function"))  # as of another release of numba
SPOILT: dict[str, Callable[[Path, bytes], object]] = {
    "empty": lambda path, intact: path.touch(),
    "header": lambda path, intact: path.write_bytes(intact[:30]),
    "cut": lambda path, intact: path.write_bytes(intact[:-1]),
    "foreign": lambda path, _: path.write_bytes(hashlib.sha256(FOREIGN).digest() + FOREIGN),
    "folder": lambda path, intact: path.mkdir(),
}


@pytest.mark.posix
@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT)
def test_a_spoilt_file_is_compiled_again(
    spoil: Callable[[Path, bytes], object], folder: Path
) -> None:
    path = only_file(folder)
    intact = path.read_bytes()
    path.unlink()
    spoil(path, intact)
    assert hits(folder) == 0
    assert path.is_dir() or hits(folder) == 1


@pytest.mark.posix
def test_a_folder_that_is_a_link_or_not_the_users_own_is_not_used(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "link").symlink_to(folder)
    assert hits(tmp_path / "link") == 0
    before = only_file(folder).stat().st_mtime_ns
    for mode in (0o755, 0o770, 0o707):
        folder.chmod(mode)
        assert hits(folder) == 0
    folder.chmod(0o700)
    assert hits(folder) == 1
    other = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: other)
    assert hits(folder) == 0
    assert only_file(folder).stat().st_mtime_ns == before


def test_without_a_place_to_keep_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    assert hits(tmp_path / "file" / "compiled") == 0
    assert hits(tmp_path / "file") == 0
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(cache, "write_atomically", Mock(side_effect=full))
    assert hits(tmp_path / "compiled") == 0
    assert not list((tmp_path / "compiled").iterdir())


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "cache_folder", Mock(side_effect=RuntimeError("no home directory")))
    function: Any = entry_point(double)
    assert function(4) == 8


def test_a_numba_whose_results_cannot_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(CompileResult, "_reduce")
    assert hits(tmp_path / "compiled") == 0


def test_the_key_has_what_a_function_closes_over(tmp_path: Path) -> None:
    def scaled(factor: int) -> Any:
        def multiply(x: int) -> int:
            return factor * x

        function: Any = numba.njit(multiply)
        function._cache = CompileCache(multiply, tmp_path / "compiled")
        return function

    assert [scaled(factor)(5) for factor in (2, 3, 2)] == [10, 15, 10]
    assert len(list((tmp_path / "compiled").iterdir())) == 2


def test_other_sources_and_bounds_checking_are_another_key(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(numba.config, "BOUNDSCHECK", 1)
        assert hits(folder) == 0
    monkeypatch.setattr(cache, "source_digest", lambda folder: "changed")
    assert hits(folder) == 0


def test_digest_changes_with_any_file(tmp_path: Path) -> None:
    first = digest_of(tmp_path)
    (tmp_path / "a.py").write_text("x = 1\n")
    second = digest_of(tmp_path)
    (tmp_path / "a.py").write_text("x = 2\n")
    third = digest_of(tmp_path)
    (tmp_path / "a.py").rename(tmp_path / "b.py")
    assert len({first, second, third, digest_of(tmp_path)}) == 4
    rooms = Path(magical.__file__).parent
    assert digest_of(tmp_path, *(rooms / room for room in SHARED)) == source_digest(tmp_path)


def test_the_key_has_the_sources_of_every_kernel() -> None:
    """A kernel's compiled code changes only with its folder, the shared rooms and constants."""
    package = Path(magical.__file__).parent
    for path in package.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "from magical.compiled.jit import" not in text:
            continue
        folders = (path.parent, *(package / room for room in SHARED))
        for module in re.findall(r"^from (magical\.(?!errors)\S+) import", text, re.MULTILINE):
            file = package.parent.joinpath(*module.split("."))
            assert any(file.is_relative_to(folder) for folder in folders), (path, module)


def test_the_oldest_files_are_removed(folder: Path) -> None:
    for i in range(MAX_FILES + 5):
        (folder / f"old-{i}.bin").write_bytes(b"")
        os.utime(folder / f"old-{i}.bin", (i, i))
    next(folder.glob("double-*")).write_bytes(b"")
    assert hits(folder) == 0
    assert len(list(folder.iterdir())) == MAX_FILES
    assert list(folder.glob("double-*"))
    assert not (folder / "old-0.bin").exists()


def test_numbas_own_setting_moves_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert cache_folder() == tmp_path / "magical-benchmark" / "compiled"
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "/caches")
    assert cache_folder() == Path("/caches", "magical-benchmark", "compiled")


def test_two_processes_compile_at_once_and_a_third_loads(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def start() -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", STORE], env=environment, stdout=subprocess.PIPE, text=True
        )

    together = [start(), start()]
    assert {process.communicate()[0] for process in together} <= {"True 0 1\n", "False 1 0\n"}
    assert start().communicate()[0] == "False 1 0\n"
    assert not list(tmp_path.rglob("*.part"))
