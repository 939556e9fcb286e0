"""Tasks by name, and tasks from outside the package."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magical.errors import InvalidTaskError, UnknownNameError
from magical.tasks import TASKS, get_task, register_task, registry, unregister_task
from magical.tasks.make_line import TASK as MAKE_LINE

NEW = replace(MAKE_LINE, name="MakeTwoLines", section="", summary="Two lines.")


def test_the_appendixs_tasks_come_first_in_its_order() -> None:
    assert [task.name for task in TASKS.values() if task.section] == [
        "MoveToCorner",
        "MoveToRegion",
        "MatchRegions",
        "MakeLine",
        "FindDupe",
        "FixColour",
        "ClusterColour",
        "ClusterShape",
    ]
    assert sorted(TASKS.values(), key=lambda task: not task.section) == list(TASKS.values())


def test_every_module_describes_itself_and_its_task_in_one_line() -> None:
    modules = [m for name, m in sys.modules.items() if name.startswith("magical.tasks.")]
    for module in modules:
        if (task := getattr(module, "TASK", None)) is None:
            continue
        assert (module.__doc__ or "").startswith(f"{task.name}: ")
        if task.section:
            assert f"appendix {task.section}" in (module.__doc__ or "")
        assert "\n" not in task.summary


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


def test_a_new_file_in_the_package_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "moretasks"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "helpers.py").write_text("")
    (package / "new.py").write_text(
        "from dataclasses import replace\n"
        "from magical.tasks.make_line import TASK as MAKE_LINE\n"
        "TASK = replace(MAKE_LINE, name='New')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    registry.discover("moretasks", [str(package)])
    assert unregister_task("New").name == "New"
