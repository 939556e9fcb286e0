"""`magical bench`, and the scripts in `benchmarks/` that go with it, in small."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from magical import cli

RATES = ("steps", "state_steps", "physics_steps", "frames")
KEYS = {"env_id", "num_envs", "workers", *(f"{rate}_per_second" for rate in RATES)}
SMALL = ["--seconds", "0.2", "--json"]


def bench(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert cli.main(["bench", *arguments, *SMALL]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("bare physics") for line in lines)
    result: dict[str, Any] = json.loads(lines[-1])
    assert result.keys() == KEYS
    return result


def test_one_environment(capsys: pytest.CaptureFixture[str]) -> None:
    result = bench(capsys, "env", "--env", "magical/MoveToCorner-Demo-LoResStack-v0")
    assert (result["num_envs"], result["workers"]) == (1, 0)
    assert result["frames_per_second"] == 2 * result["steps_per_second"]
    assert 0 < result["steps_per_second"] < result["physics_steps_per_second"]
    assert result["state_steps_per_second"] > 0  # almost all of it physics


@pytest.mark.parametrize("workers", [0, 1])
def test_many(capsys: pytest.CaptureFixture[str], workers: int) -> None:
    env_id = "magical/MoveToCorner-Demo-LoRes4A-v0"
    result = bench(capsys, "vector", "--env", env_id, "--num-envs", "3", "--workers", str(workers))
    assert (result["env_id"], result["num_envs"], result["workers"]) == (env_id, 3, workers)
    assert result["frames_per_second"] == result["steps_per_second"]
    assert 0 < result["steps_per_second"] < result["physics_steps_per_second"]


def test_an_unknown_environment_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "env", "--env", "magical/MoveToCornr-Demo-v0"]) == 2
    assert "did you mean 'MoveToCorner'" in capsys.readouterr().err


def script(root: Path, name: str, *arguments: str) -> str:
    command = [sys.executable, str(root / "benchmarks" / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    return str(done.stdout)


@pytest.mark.linux
def test_soak_reports_what_it_watched(root: Path) -> None:
    output = script(
        root, "soak.py", "--steps", "12000", "--workers", "1", "--observation", "LoRes4A"
    )
    assert "memory grew by" in output
    assert "shared memory: 0 mappings before, 0 after" in output
    assert output.count("Usage(") == 20


def test_a_checkout_is_compared_with_itself(root: Path) -> None:
    lines = script(root, "paired.py", str(root), "--seconds", "0.1").splitlines()
    assert [line.partition("before")[0].strip() for line in lines] == [
        "simulation",
        "state only",
        "with pixels",
    ]


def test_step_profile_adds_up(root: Path) -> None:
    lines = script(root, "step_profile.py", "--num-envs", "2").splitlines()
    shares = [float(line.split()[-1].rstrip("%")) for line in lines]
    assert shares[-1] == 100
    assert sum(shares[:-1]) == pytest.approx(100, abs=1)
