"""What children import: never what lies in the working folder without having been chosen."""

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from magical.processes.import_path import absolute_python_path, folders_of_modules, import_path

HOSTILE = (
    *("json", "pickle", "struct", "signal", "threading", "subprocess", "multiprocessing"),
    *("numpy", "gymnasium", "magical", "sitecustomize", "usercustomize"),
)
# Imports what this process needs, then fills the working folder with such files, then starts
# children.
PROGRAM = f"""
from pathlib import Path
import beside
from magical.envs.vector import MagicalVectorEnv
from magical.processes import map_in_processes
for name in {HOSTILE!r}:
    Path(name + ".py").write_text("open('executed', 'a').write(__name__ + ' ')")
print(*map_in_processes(beside.double, [1, 2], 2))
envs = MagicalVectorEnv(["magical/MakeLine-Demo-v0"] * 2, workers=2, observation="state")
envs.reset(seed=0)
envs.close()
"""
BESIDE = "def double(number):\n    return 2 * number\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder."""
    path = tmp_path / "folder"
    path.mkdir()
    monkeypatch.chdir(path)
    return path


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """The folder of a script."""
    path = tmp_path / "elsewhere"
    path.mkdir()
    (path / "program.py").write_text(PROGRAM)
    (path / "beside.py").write_text(BESIDE)
    return path


@pytest.mark.parametrize("how", ["script", "-c", "-m", "standard input", "empty in PYTHONPATH"])
def test_nothing_in_the_working_folder_is_executed(how: str, folder: Path, elsewhere: Path) -> None:
    script = str(elsewhere / "program.py")
    arguments = {"-c": ["-c", PROGRAM], "-m": ["-m", "program"], "standard input": ["-"]}
    variable = os.environ.get("PYTHONPATH", "")
    if how in arguments:  # Python puts the working folder on its path
        (folder / "program.py").write_text(PROGRAM)
        (folder / "beside.py").write_text(BESIDE)
    elif how != "script":
        variable = os.pathsep.join(["", variable])
    done = subprocess.run(
        [sys.executable, *arguments.get(how, [script])],
        env={**os.environ, "PYTHONPATH": variable},
        input=PROGRAM,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout, done.stderr, done.returncode) == ("2 4\n", "", 0)
    assert (folder / "json.py").exists()
    assert not (folder / "executed").exists()


Start = Callable[..., list[str]]


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> Start:
    """The import path of the children of an interpreter that was started in a certain way."""

    def started(path: list[str], module: str | None = None, variable: str = "") -> list[str]:
        main: Any = ModuleType("__main__")
        main.__spec__ = module and ModuleSpec(module, None)
        monkeypatch.setitem(sys.modules, "__main__", main)
        monkeypatch.setattr(sys, "path", path)
        monkeypatch.setenv("PYTHONPATH", variable)
        return import_path()

    return started


def test_a_working_folder_that_python_added_is_left_out(folder: Path, start: Start) -> None:
    here = str(folder)
    assert start(["", "/lib"]) == ["/lib"]
    assert start([here, "/lib"], "program") == ["/lib"]
    assert start(["/bin", here, "/lib"], variable=":/x") == ["/bin", "/lib"]
    assert start([here, here, "/lib"], "program", variable=":/x") == ["/lib"]


def test_a_working_folder_that_was_chosen_stays(folder: Path, start: Start) -> None:
    here = str(folder)
    assert start([here, "/lib"]) == [here, "/lib"]  # a script in it
    assert start([here, "/lib"], "__main__") == [here, "/lib"]  # python FOLDER
    named = [here, here, "/lib"]
    assert start(named, "program", variable=here) == named
    assert start(named, "program", variable="/x:.") == named
    assert start([here, here, "/lib"], "program") == named  # added by the program
    assert start(["", "/lib", "."]) == ["/lib", here]


def test_entries_are_absolute_texts(folder: Path, start: Start) -> None:
    odd: list[str] = ["sub", Path("/path"), "/lib"]  # type: ignore[list-item]
    assert start(odd) == [str(folder / "sub"), "/lib"]
    start([], variable=":/a:b::/c")
    assert absolute_python_path() == "/a:/c"


def test_modules_from_elsewhere_are_found_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "single.py").touch()
    (folder / "packed").mkdir()
    (folder / "packed" / "__init__.py").touch()
    (folder / "spaced").mkdir()
    names = ["single", "packed", "spaced"]
    with monkeypatch.context() as patch:
        patch.syspath_prepend(folder)
        for name in names:
            patch.setitem(sys.modules, name, __import__(name))
        assert not {*names} & {*folders_of_modules(sys.path)}
        found = folders_of_modules([entry for entry in sys.path if entry != str(folder)])
    assert {name: found.get(name) for name in names} == dict.fromkeys(names, str(folder))
    assert "os" not in found


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
