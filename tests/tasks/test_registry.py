"""Tasks by name, and a ninth task from outside the package."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magical.errors import InvalidTaskError, UnknownNameError
from magical.tasks import TASKS, get_task, register_task, registry, unregister_task
from magical.tasks.make_line import TASK as MAKE_LINE

NINTH = replace(MAKE_LINE, name="MakeTwoLines", section="", summary="Two lines.")


def test_tasks_are_in_the_appendixs_order() -> None:
    assert list(TASKS) == [
        "MoveToCorner",
        "MoveToRegion",
        "MatchRegions",
        "MakeLine",
        "FindDupe",
        "FixColour",
        "ClusterColour",
        "ClusterShape",
    ]


def test_every_module_describes_itself_and_its_task_in_one_line() -> None:
    for task in TASKS.values():
        module = sys.modules[task.score_fn.__module__]
        assert (module.__doc__ or "").startswith(f"{task.name}: ")
        assert f"appendix {task.section}" in (module.__doc__ or "")
        assert "\n" not in task.summary


def test_unknown_task_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError) as error:
        get_task("MakeLines")
    assert "'MakeLines' is no task; expected one of: MoveToCorner, " in str(error.value)
    assert str(error.value).endswith("did you mean 'MakeLine'?")


def test_names_are_exact() -> None:
    assert get_task("MakeLine") is MAKE_LINE
    with pytest.raises(UnknownNameError):
        get_task("makeline")


def test_a_ninth_task_can_be_registered_and_taken_out() -> None:
    assert register_task(NINTH) is NINTH
    try:
        assert list(TASKS)[-1] == "MakeTwoLines"
        assert get_task("MakeTwoLines").sample("TestAll", np.random.default_rng(0))
        register_task(NINTH)  # the same again changes nothing
        assert len(TASKS) == 9
    finally:
        assert unregister_task("MakeTwoLines") is NINTH
    assert len(TASKS) == 8
    with pytest.raises(UnknownNameError):
        unregister_task("MakeTwoLines")


def test_a_taken_name_is_refused() -> None:
    with pytest.raises(InvalidTaskError, match="found 'MakeLine', which is registered"):
        register_task(replace(MAKE_LINE, horizon=7))
    assert get_task("MakeLine") is MAKE_LINE


def test_a_new_file_in_the_package_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "moretasks"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "helpers.py").write_text("")
    (package / "ninth.py").write_text(
        "from dataclasses import replace\n"
        "from magical.tasks.make_line import TASK as MAKE_LINE\n"
        "TASK = replace(MAKE_LINE, name='Ninth')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    registry.discover("moretasks", [str(package)])
    assert unregister_task("Ninth").name == "Ninth"


def test_the_table_of_tasks_cannot_be_changed_from_outside() -> None:
    with pytest.raises(TypeError):
        TASKS["MakeLine"] = NINTH  # type: ignore[index]
