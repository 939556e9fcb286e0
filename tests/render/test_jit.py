"""What is kept on disk is renewed when the code changes, and not needed to draw."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

import magical.render
from magical.render import jit

STORE = (
    "import numpy as np\n"
    "from magical.render.output import compiled_store\n"
    "store = compiled_store()\n"
    "store(np.zeros(4, np.int32), np.empty((2, 2, 3), np.uint8))\n"
    "print(sum(store.stats.cache_hits.values()), sum(store.stats.cache_misses.values()))\n"
)


def test_stamp_changes_with_any_file(tmp_path: Path) -> None:
    first = jit.stamp_of(tmp_path)
    (tmp_path / "a.py").write_text("x = 1\n")
    second = jit.stamp_of(tmp_path)
    (tmp_path / "a.py").write_text("x = 2\n")
    assert len({first, second, jit.stamp_of(tmp_path)}) == 3
    assert jit.stamp_of(Path(magical.render.__file__).parent) == jit.source_stamp()


def test_the_second_process_loads_what_the_first_compiled(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", STORE]
    hits = [
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert hits == ["0 1\n", "1 0\n"]


def test_without_a_place_to_keep_it(monkeypatch: pytest.MonkeyPatch) -> None:
    real: Any = numba.njit

    def njit(*args: Any, cache: bool = False) -> Any:
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return real(*args)

    monkeypatch.setattr(numba, "njit", njit)

    def double(x: int) -> int:
        return 2 * x

    assert jit.entry_point(double)(4) == 8
