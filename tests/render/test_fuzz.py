"""Whatever scene and poses it is given, the renderer stays within its arrays, and comes back."""

import os
import re
import subprocess
import sys
from pathlib import Path

MUTANTS = 300


def test_mutants_are_rendered_or_refused(root: Path, tmp_path: Path) -> None:
    """With bounds checking, which compiled code has not otherwise."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.render.fuzz", str(MUTANTS)],
        cwd=root,
        env={
            **os.environ,
            "NUMBA_BOUNDSCHECK": "1",
            "NUMBA_OPT": "0",  # which compiles faster
            "NUMBA_CACHE_DIR": str(tmp_path),
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    found = re.fullmatch(r"(\d+) rendered, (\d+) refused, 0 escaped\n", done.stdout)
    assert found is not None, done.stdout
    rendered, refused = map(int, found.groups())
    assert rendered + refused == MUTANTS
    assert min(rendered, refused) > MUTANTS / 5
