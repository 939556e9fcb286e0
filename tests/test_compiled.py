"""Compiled code on disk: used when it is of today's sources and the user's own, never needed."""

import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numba
import pytest
from numba.core.caching import IndexDataCacheFile

import magical
from magical.compiled import SHARED, kernel

PACKAGE = Path(magical.__file__).parent
WRITE = (
    "import sys\n"
    "import numpy as np\n"
    "from magical.render.kernel import write\n"
    "image = np.empty((2, 2, 3), np.uint8)\n"
    "write(np.arange(4, dtype=np.int32), image)\n"
    "assert image[:, :, 0].tolist() == [[2, 3], [0, 1]]\n"
    "print('numba.np.linalg' in sys.modules, end=' ')  # slow to import\n"
    "print(sum(write.stats.cache_hits.values()))\n"
)
CORNER = (
    "from magical.render import render_frame\n"
    "from magical.scene import Pose, Poses, Scene\n"
    "scene = Scene(Pose(0.0, 0.0, 0.0))\n"
    "print(render_frame(scene, Poses.at_rest(scene), 'allo', 384)[0, 0].tolist())\n"
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where compiled code is kept."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    return tmp_path / "magical-benchmark"


def scaled(factor: int) -> Any:
    def multiply(x: int) -> int:
        return factor * x

    return kernel(multiply)


def is_kept(factor: int = 2) -> bool:
    """Whether a function, whose result is checked, was found on disk."""
    function = scaled(factor)
    assert function(21) == 21 * factor
    return bool(function.stats.cache_hits)


def test_what_was_compiled_is_loaded_with_what_it_closes_over(folder: Path) -> None:
    assert [is_kept(factor) for factor in (2, 3, 2, 3)] == [False, False, True, True]


def run(program: str, folder: Path, source: Path = PACKAGE.parent) -> "subprocess.Popen[str]":
    paths = {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(source)}
    command = [sys.executable, "-c", program]
    return subprocess.Popen(command, env=os.environ | paths, stdout=subprocess.PIPE, text=True)


def test_two_processes_compile_at_once_and_a_third_loads(tmp_path: Path) -> None:
    for process in [run(WRITE, tmp_path), run(WRITE, tmp_path)]:
        process.communicate()
        assert process.returncode == 0
    assert run(WRITE, tmp_path).communicate()[0] == "False 1\n"


def test_an_edited_constant_elsewhere_changes_the_frame(tmp_path: Path) -> None:
    source = tmp_path / "source" / "magical"
    shutil.copytree(PACKAGE, source, ignore=shutil.ignore_patterns("__pycache__"))
    assert run(CORNER, tmp_path, source.parent).communicate()[0] == "[231, 231, 234]\n"
    assert list(tmp_path.rglob("kernel.frame_kernel*.nbc"))
    palette, times = source / "render" / "palette.py", (source / "render" / "palette.py").stat()
    text = palette.read_text(encoding="utf-8")
    palette.write_text(text.replace("OUTSIDE: RGB = (231,", "OUTSIDE: RGB = (131,"))
    os.utime(palette, ns=(times.st_atime_ns, times.st_mtime_ns + 2_000_000_000))
    assert run(CORNER, tmp_path, source.parent).communicate()[0] == "[131, 231, 234]\n"


def test_kernels_take_constants_from_the_sources_in_their_key_alone() -> None:
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "from magical.compiled import" not in text or not re.search("@(inlined|kernel)", text):
            continue
        known = (path.parent, *(PACKAGE / name for name in SHARED))
        for module in re.findall(r"^from (magical\.(?!errors)\S+) import", text, re.MULTILINE):
            file = PACKAGE.parent.joinpath(*module.split("."))
            file = file if file.is_dir() else file.with_suffix(".py")
            assert any(file.is_relative_to(each) for each in known), (path, module)


@pytest.mark.posix
@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_may_write_is_not_used(folder: Path, mode: int) -> None:
    assert not is_kept()
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(mode)
    assert not is_kept()
    folder.chmod(0o700)
    assert is_kept()


@pytest.mark.posix
def test_a_folder_of_another_user_or_a_link_is_not_used(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not is_kept()
    folder.rename(tmp_path / "moved")
    folder.symlink_to(tmp_path / "moved")
    assert not is_kept()
    folder.unlink()
    (tmp_path / "moved").rename(folder)
    other = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: other)
    assert not is_kept()


def test_without_a_place_to_keep_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = OSError(errno.ENOSPC, "No space left on device")
    with monkeypatch.context() as patch:
        patch.setattr(IndexDataCacheFile, "save", Mock(side_effect=full))
        assert not is_kept()
    folder.rmdir()
    folder.write_text("in the way")
    assert not is_kept()
    monkeypatch.setattr(Path, "expanduser", Mock(side_effect=RuntimeError("no home directory")))
    assert not is_kept()
