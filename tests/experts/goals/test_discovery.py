"""A task's goals are found by the name of its file, or registered."""

import pkgutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import magical.experts.goals
import magical.tasks
from magical.errors import NoExpertError
from magical.experts import (
    Expert,
    Goals,
    Move,
    Plan,
    StateView,
    Strategy,
    expert_for,
    get_goals,
    register_goals,
)
from magical.experts.goals import _packaged_goals, _registered, _task_files
from magical.physics import Simulation
from magical.tasks import TASKS, get_task
from tests.experts.scenes import state_of

TASK_FILE = """
from dataclasses import replace
from magical.tasks.make_line import TASK as MAKE_LINE
TASK = replace(MAKE_LINE, name="NinthTask", section="", summary="Ninth.")
"""
GOALS_FILE = """
from magical.experts.planning import Goals, Plan
GOALS = Goals(lambda view, strategy, last: Plan())
"""


@pytest.fixture
def add_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Adds a module of the given text to `magical.tasks` or `magical.experts.goals`."""
    before = set(sys.modules)

    def add(package: object, name: str, text: str) -> None:
        folder = tmp_path / str(package.__name__)  # type: ignore[attr-defined]
        folder.mkdir()
        (folder / name).write_text(text)
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])  # type: ignore[attr-defined]
        forget()

    def forget() -> None:
        _packaged_goals.cache_clear()
        _task_files.cache_clear()

    yield add
    monkeypatch.undo()
    forget()
    for name in set(sys.modules) - before:
        del sys.modules[name]


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_an_expert(task: str) -> None:
    assert isinstance(expert_for(task, seed=0), Expert)


def test_every_file_of_goals_has_the_name_of_a_tasks_file() -> None:
    """Files of other names would not be found; helpers begin with an underscore."""
    files = {module.name for module in pkgutil.iter_modules(magical.experts.goals.__path__)}
    assert {name for name in files if not name.startswith("_")} <= set(_task_files().values())


def test_goals_are_found_by_the_tasks_file(add_file: Callable[..., None]) -> None:
    add_file(magical.tasks, "ninth.py", TASK_FILE)
    add_file(magical.experts.goals, "ninth.py", GOALS_FILE)
    assert isinstance(get_goals("NinthTask"), Goals)


def test_error_names_the_file_to_add_for_a_packaged_task(add_file: Callable[..., None]) -> None:
    add_file(magical.tasks, "ninth.py", TASK_FILE)
    message = r"'NinthTask' has no scripted expert; .*add magical/experts/goals/ninth.py, or call"
    with pytest.raises(NoExpertError, match=message):
        get_goals("NinthTask")


def test_error_names_the_call_for_a_task_from_outside() -> None:
    message = r"expected one of: .*MoveToCorner.*; call magical.experts.register_goals"
    with pytest.raises(NoExpertError, match=message):
        expert_for("StackTower", seed=0)


def test_a_task_from_outside_gets_its_expert() -> None:
    def plan(view: StateView, strategy: Strategy, last: Plan) -> Plan:
        there = (0.5, 0.5)
        return Plan((Move(there, 0.1),)) if view.distance_to(there) > 0.1 else Plan()

    register_goals("DriveThere", Goals(plan))
    try:
        scene = get_task("MoveToRegion").demo
        simulation, expert, memory = Simulation(scene), expert_for("DriveThere", seed=0), None
        for _ in range(40):
            action, memory = expert.act(state_of(simulation, scene), memory)
            simulation.step(action)
        assert np.hypot(*(simulation.poses().bodies[0, :2] - 0.5)) < 0.2
    finally:
        del _registered["DriveThere"]
