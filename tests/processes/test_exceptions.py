"""Exceptions on their way from a child to its parent."""

from typing import Any

import pytest

from magical.errors import UnknownNameError, WorkerError
from magical.processes import WorkerTraceback, map_in_processes, outcomes_in_processes
from tests.processes import work


def sent(*kinds: str) -> list[Any]:
    """The exceptions that children have raised."""
    return list(outcomes_in_processes(work.raise_error, kinds, 2))


def test_built_in_exceptions_and_the_packages_own_keep_everything() -> None:
    value, file, package = sent("value", "file", "package")
    assert (type(value), value.args) == (ValueError, ("not this one", 3))
    assert value.__notes__ == ["in environment 2"]
    assert (type(file), str(file)) == (FileNotFoundError, "[Errno 2] No such file: 'name.txt'")
    assert (type(package), str(package)) == (UnknownNameError, "no task")


def test_others_are_named() -> None:
    messages = {
        "foreign": "tests.processes.work.Foreign: (1, <function",
        "unprintable": "tests.processes.work.Unprintable: <exception str() failed>",
        "argument": "ValueError: <function",
        "namesake": "elsewhere.ValueError: text",
    }
    for error, message in zip(sent(*messages), messages.values(), strict=True):
        assert type(error) is WorkerError
        assert str(error).startswith(message)
        assert error.__notes__ == ["in environment 2"]


def test_the_traceback_of_the_child_is_the_cause() -> None:
    with pytest.raises(ValueError, match="not this one") as caught:
        list(map_in_processes(work.raise_error, ["value"], 2))
    assert isinstance(caught.value.__cause__, WorkerTraceback)
    assert "in raise_error" in str(caught.value.__cause__)
    assert "ValueError: ('not this one', 3)" in str(caught.value.__cause__)
