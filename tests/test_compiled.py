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
# Moves a robot forward; prints how far, whether something slow was imported, and kernels found.
DRIVE = (
    "import sys\n"
    "from magical.physics import Simulation, substeps\n"
    "from magical.scene import Pose, Scene\n"
    "simulation = Simulation(Scene(Pose(0.0, -0.5, 0.0)))\n"
    "forward = [simulation.step((1.0, 0.0, 1.0)) for _ in range(8)][-1][0, 1]\n"
    "hits = sum(substeps.step_rows.stats.cache_hits.values())\n"
    "print(forward > 0.0, 'numba.np.linalg' in sys.modules, hits)\n"
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where compiled code is kept."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    return tmp_path / "magical-benchmark"


def is_kept(factor: int = 2) -> bool:
    """Whether a function, whose result is checked, was found on disk."""

    def multiply(x: int) -> int:
        return factor * x

    function: Any = kernel(multiply)
    assert function(21) == 21 * factor
    return bool(function.stats.cache_hits)


def test_what_was_compiled_is_loaded_with_what_it_closes_over(folder: Path) -> None:
    assert [is_kept(factor) for factor in (2, 3, 2, 3)] == [False, False, True, True]


def test_an_edited_constant_elsewhere_is_compiled_again(tmp_path: Path) -> None:
    source = tmp_path / "source" / "magical"
    shutil.copytree(PACKAGE, source, ignore=shutil.ignore_patterns("__pycache__"))
    paths = {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(source.parent)}

    def run() -> "subprocess.Popen[str]":
        command = [sys.executable, "-c", DRIVE]
        return subprocess.Popen(command, env=os.environ | paths, stdout=-1, text=True)

    together = [run(), run()]  # two processes compile at once
    assert {process.communicate()[0] for process in together} <= {"True True 0\n", "True False 1\n"}
    assert run().communicate()[0] == "True False 1\n"
    constants = source / "scene" / "constants.py"
    times, text = constants.stat(), constants.read_text(encoding="utf-8")
    slower = text.replace("DRIVE_SPEED_FORWARD = 4.0", "DRIVE_SPEED_FORWARD = 2.0")
    constants.write_text(slower, encoding="utf-8")
    os.utime(constants, ns=(times.st_atime_ns, times.st_mtime_ns + 2_000_000_000))
    assert run().communicate()[0].startswith("False")


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
def test_a_folder_that_others_may_write_is_not_used(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not is_kept()
    assert folder.stat().st_mode & 0o777 == 0o700
    for mode in (0o770, 0o707):
        folder.chmod(mode)
        assert not is_kept()
    folder.chmod(0o700)
    assert is_kept()
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
    monkeypatch.setattr(IndexDataCacheFile, "save", Mock(side_effect=full))
    assert not is_kept()
    folder.rmdir()
    folder.write_text("in the way")
    assert not is_kept()
