"""A task's goals are found by the task's name, or registered."""

import pkgutil
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from magical.errors import NoExpertError
from magical.experts import (
    Move,
    MovePlan,
    Planner,
    StateView,
    Strategy,
    expert_for,
    get_planner,
    goals,
    has_expert,
    register_planner,
)
from magical.experts.goals import _file, _registered
from magical.physics import Simulation
from magical.scene.actions import POINTS
from magical.tasks import TASKS, get_task, register_task, unregister_task
from tests.experts.scenes import state_of


def test_every_file_of_goals_has_the_name_of_a_task() -> None:
    """Files of other names would not be found; helpers begin with an underscore."""
    files = {module.name for module in pkgutil.iter_modules(goals.__path__)}
    assert {name for name in files if not name.startswith("_")} <= set(map(_file, TASKS))


@pytest.fixture
def drive_there() -> Iterator[str]:
    """A task from outside the package, without an expert."""
    region = get_task("MoveToRegion")
    task = register_task(replace(region, name="DriveThere", section=""))
    yield task.name
    unregister_task(task.name)
    _registered.pop(task.name, None)


def test_the_error_says_how_to_add_an_expert(drive_there: str) -> None:
    message = (
        r"expected one of: MoveToCorner, .*; add magical/experts/goals/drive_there.py, "
        r"an entry point DriveThere .* or call magical.experts.register_planner\('DriveThere'"
    )
    assert not has_expert(drive_there)
    for name in (drive_there, "../DriveThere", "StackTower"):
        with pytest.raises(NoExpertError, match=message if name == drive_there else "no scripted"):
            get_planner(name)


def test_a_task_from_outside_gets_its_expert(drive_there: str) -> None:
    def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
        there = (0.5, 0.5)
        return MovePlan((Move(there, 0.1),) if view.distance_to(there) > 0.1 else ())

    register_planner(drive_there, Planner(plan))
    scene = get_task("MoveToRegion").demo
    simulation, expert, memory = Simulation(scene), expert_for(drive_there, seed=0), None
    for _ in range(40):
        action, memory = expert.act(state_of(simulation, scene), memory)
        simulation.step(POINTS[action])
    assert np.hypot(*(simulation.poses().bodies[0, :2] - 0.5)) < 0.2
