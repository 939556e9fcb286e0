"""The scripts in `benchmarks/`, in small."""

import subprocess
import sys
from pathlib import Path

import pytest


def script(root: Path, name: str, *arguments: str) -> str:
    command = [sys.executable, str(root / "benchmarks" / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    return str(done.stdout)


def test_regression_prints_a_ratio_for_each_measurement(root: Path) -> None:
    lines = script(root, "regression.py", "--rounds", "1").splitlines()
    assert len(lines) == 5
    assert all(float(line.split()[-1]) > 0 for line in lines)


def test_stepping_measures_one_and_many(root: Path) -> None:
    lines = script(root, "stepping.py", "--num-envs", "2", "--workers", "0", "--seconds", "0.1")
    rates = {name: rate for name, _, rate in (x.rpartition("  ") for x in lines.splitlines())}
    assert {name.partition(",")[0] for name in rates} == {"1 environment", "2 environments"}
    assert len(rates) == 4


def test_a_checkout_is_compared_with_itself(root: Path) -> None:
    lines = script(root, "paired.py", str(root), "--seconds", "0.1").splitlines()
    assert [line.partition("before")[0].strip() for line in lines] == [
        "simulation",
        "state only",
        "with pixels",
        "reset",
    ]


def test_step_profile_adds_up(root: Path) -> None:
    lines = script(root, "step_profile.py", "--num-envs", "2").splitlines()
    shares = [float(line.split()[-1].rstrip("%")) for line in lines]
    assert shares[-1] == 100
    assert sum(shares[:-1]) == pytest.approx(100, abs=1)
