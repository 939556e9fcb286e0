"""Children import what their parent does."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HOSTILE = (
    *("json", "pickle", "struct", "signal", "threading", "subprocess", "multiprocessing"),
    *("numpy", "gymnasium", "magical", "sitecustomize", "usercustomize"),
)
PROGRAM = """
import beside
from magical.processes import map_in_processes
print(*map_in_processes(beside.double, [1, 2], 2))
"""
BESIDE = "def double(number):\n    return 2 * number\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder."""
    path = tmp_path / "folder"
    path.mkdir()
    monkeypatch.chdir(path)
    return path


@pytest.mark.parametrize("how", ["script", "-c", "-m", "standard input", "relative in PYTHONPATH"])
def test_children_find_what_their_parent_has_imported(
    how: str, folder: Path, tmp_path: Path
) -> None:
    arguments = {"-c": ["-c", PROGRAM], "-m": ["-m", "program"], "standard input": ["-"]}
    place = folder if how in arguments else tmp_path
    (place / "program.py").write_text(PROGRAM)
    there = place if how != "relative in PYTHONPATH" else folder / "modules"
    there.mkdir(exist_ok=True)
    (there / "beside.py").write_text(BESIDE)
    done = subprocess.run(
        [sys.executable, *arguments.get(how, [str(place / "program.py")])],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(["modules", os.environ.get("PYTHONPATH", "")]),
        },
        input=PROGRAM,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout, done.stderr, done.returncode) == ("2 4\n", "", 0)


def test_evaluating_a_policy_in_a_folder_executes_nothing_else_there(folder: Path) -> None:
    for name in (*HOSTILE, "this"):
        (folder / f"{name}.py").write_text("open('executed', 'a').write(__name__ + ' ')")
    (folder / "policy.py").write_text(
        "def act(observations, env_ids, rng):\n    return [0]\nact.observation = 'state'\n"
    )
    command = "import sys; from magical.cli import main; sys.exit(main(sys.argv[1:]))"
    arguments = ["evaluate", "policy:act", "--task", "MakeLine", "--variants", "Demo"]
    arguments += ["--rollouts", "1", "--horizon", "1", "--workers", "1"]
    done = subprocess.run(
        [sys.executable, "-P", "-c", command, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not (folder / "executed").exists()
