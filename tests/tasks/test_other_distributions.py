"""A task and its expert of another distribution, found by entry points and by `module:NAME`."""

import subprocess
import sys
from argparse import ArgumentTypeError
from pathlib import Path

import pytest

from magical import plugins
from magical.commands._common import task_name
from magical.envs import parse_env_id
from magical.errors import PluginError, UnknownNameError
from magical.tasks import TASKS, get_task, load_task, registry, unregister_task

TASK = """
from dataclasses import replace
from magical.tasks import get_task
TASK = replace(get_task("MoveToRegion"), name="DriveThere", section="")
"""
PLANNER = """
from magical.experts import MovePlan, Planner, get_planner
PLANNER = Planner(lambda *arguments: get_planner("MoveToRegion").plan_fn(*arguments))
"""
ENTRY_POINTS = """
[magical.tasks]
DriveThere = driving_task:TASK
Misnamed = driving_task:TASK
[magical.experts]
DriveThere = driving_expert:PLANNER
"""
SCRIPT = """
import sys, gymnasium, magical
from magical.errors import UnknownNameError
from magical.experts import has_expert, rollout
assert {"MoveToCorner", "DriveThere"} <= set(magical.TASKS) and has_expert("DriveThere")
assert "magical/DriveThere-TestAll-LoRes4E-v0" in gymnasium.registry
assert not {"driving_task", "driving_expert"} & set(sys.modules)  # nothing is imported yet
env = gymnasium.make("magical/DriveThere-Demo-v0")
assert "driving_task" in sys.modules and "driving_expert" not in sys.modules
magical.register_task(env.unwrapped.task)  # again; as a module would that is imported by name
try:
    gymnasium.make("magical/DriveThere-TestShape-v0")
except UnknownNameError as error:
    print(error)
assert rollout("DriveThere", seed=0).score == 1.0
"""


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """A folder in which a distribution is installed."""
    info = tmp_path / "driving-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: driving\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    (tmp_path / "driving_task.py").write_text(TASK)
    (tmp_path / "driving_expert.py").write_text(PLANNER)
    return tmp_path


def test_entry_points_are_imported_when_they_are_needed(other: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", SCRIPT],
        env={"PYTHONPATH": str(other)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "DriveThere has no variant 'TestShape'; it has: Demo," in done.stdout


def test_module_and_name(other: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(other)
    for env_id in ("magical/DriveThere-Demo-v0", "driving_task:TASK-Demo-v0"):
        with pytest.raises(UnknownNameError, match=r"task '.*' is not registered; expected"):
            parse_env_id(env_id)
    assert "driving_task" not in sys.modules  # ids may come from anywhere, and import nothing
    try:
        assert task_name("driving_task:TASK") == "DriveThere"
        assert get_task("DriveThere") is load_task("driving_task:TASK")
        assert parse_env_id("magical/DriveThere-Demo-v0").task == "DriveThere"
    finally:
        unregister_task("DriveThere")
    with pytest.raises(PluginError, match="expected a Task, found function"):
        load_task("driving_task:replace")
    with pytest.raises(ArgumentTypeError, match="no 'NO' in the module"):
        task_name("driving_task:NO")


def test_a_task_of_another_name_than_its_entry_points(
    other: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(other)
    plugins.plugins.cache_clear()
    try:
        assert list(TASKS)[-2:] == ["DriveThere", "Misnamed"]
        with pytest.raises(PluginError, match="expected the task 'Misnamed', found 'DriveThere'"):
            get_task("Misnamed")
    finally:
        plugins.plugins.cache_clear()
        registry._tasks.pop("DriveThere", None)
