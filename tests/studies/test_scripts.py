"""The studies' scripts that take seconds, in small."""

import subprocess
import sys
from pathlib import Path


def script(root: Path, name: str, *arguments: str) -> str:
    command = [sys.executable, "-m", f"studies.{name}", *arguments]
    done = subprocess.run(
        command, cwd=root, capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    return str(done.stdout)


def test_intervals_are_compared_in_a_table(root: Path) -> None:
    arguments = ("--simulations", "2", "--resamples", "20", "--runs", "3")
    header, *lines = script(root, "published_tables.intervals", *arguments).splitlines()
    assert header.split()[-5:] == ["ours", "separate", "percentile", "BCa", "studentised"]
    assert sum(line.count("%") == 5 for line in lines) == 15  # three designs, five statistics
