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


def test_runs_of_the_physics_are_compared(root: Path, tmp_path: Path) -> None:
    runs = {"published": ["--at-roots"], "nudged": ["--at-roots", "--nudges", "1"], "after": []}
    for name, options in runs.items():
        out = str(tmp_path / f"{name}.npz")
        assert script(root, "determinism.pymunk_versions", "runs", *options, "--out", out) == ""
    files = {**{name: name for name in runs}, "before": "published"}
    arguments = [f"--{name}={tmp_path / file}.npz" for name, file in files.items()]
    figure = tmp_path / "figure.png"
    output = script(root, "determinism.compare_runs", *arguments, "--figure", str(figure))
    by_row = {tuple(line.split(" | ")[:3]): line for line in output.splitlines()}
    same = by_row["| pin", "alone", "fingers at their roots"]
    assert same.count("0e+00 (0e+00)") == 5  # compared with itself
    assert "0e+00 (0e+00)" not in by_row["| pin", "alone", "fingers displaced"]
    assert figure.stat().st_size > 1000
