"""The scripts in `benchmarks/`, in small."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("regression.py --rounds 1", 5),
        ("stepping.py --num-envs 2 --workers 0 --seconds 0.1", 4),
        ("paired.py {root} --seconds 0.1", 4),
        ("step_profile.py --num-envs 2", None),
    ],
)
def test_each_line_is_a_measurement(root: Path, command: str, names: int | None) -> None:
    script, *arguments = command.format(root=root).split()
    words = [sys.executable, str(root / "benchmarks" / script), *arguments]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    assert names in (len(done.stdout.splitlines()), None)
