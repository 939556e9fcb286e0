"""Tasks by name, and tasks from outside the package."""

from dataclasses import replace

import numpy as np
import pytest

from magical.errors import InvalidTaskError, UnknownNameError
from magical.tasks import TASKS, get_task, register_task, unregister_task
from magical.tasks.make_line import TASK as MAKE_LINE

NEW = replace(MAKE_LINE, name="MakeTwoLines", section="", summary="Two lines.")


def test_the_appendixs_tasks_come_first_in_its_order() -> None:
    names = "MoveToCorner MoveToRegion MatchRegions MakeLine FindDupe FixColour ClusterColour"
    assert list(TASKS)[:8] == [*names.split(), "ClusterShape"]
    assert not any(task.section for task in list(TASKS.values())[8:])


def test_an_unknown_task_raises_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError) as error:
        get_task("MakeLines")
    assert "task 'MakeLines' is not registered; expected one of: MoveToCorner, " in str(error.value)
    assert "did you mean 'MakeLine'?" in str(error.value)
    with pytest.raises(UnknownNameError):
        get_task("makeline")


def test_a_task_can_be_registered_and_unregistered() -> None:
    before = list(TASKS)
    assert register_task(NEW) is NEW
    try:
        assert list(TASKS) == [*before, "MakeTwoLines"]
        assert get_task("MakeTwoLines").sample("TestAll", np.random.default_rng(0))
        register_task(NEW)  # the same again changes nothing
        assert list(TASKS) == [*before, "MakeTwoLines"]
    finally:
        assert unregister_task("MakeTwoLines") is NEW
    assert list(TASKS) == before
    with pytest.raises(UnknownNameError):
        unregister_task("MakeTwoLines")
    with pytest.raises(TypeError):
        TASKS["MakeLine"] = NEW


def test_a_taken_name_is_refused() -> None:
    with pytest.raises(InvalidTaskError, match="found 'MakeLine', which is registered already"):
        register_task(replace(MAKE_LINE, horizon=7))
    assert get_task("MakeLine") is MAKE_LINE
