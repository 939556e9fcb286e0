"""Exceptions on their way from a child to its parent."""

import json
from typing import Any

import pytest

from magical.errors import UnknownNameError, WorkerDiedError, WorkerError
from magical.processes import WorkerTraceback, describe, rebuild
from tests.processes import work


def sent(error: Exception) -> Exception:
    """An exception after its way, which is JSON for the vector environment."""
    return rebuild(json.loads(json.dumps(describe(error))))


def raised(function: Any, *arguments: Any) -> Exception:
    with pytest.raises(Exception) as caught:  # noqa: PT011  (any)
        function(*arguments)
    assert isinstance(caught.value, Exception)
    return caught.value


@pytest.mark.parametrize(
    "error",
    [
        ValueError("text", 3, 0.5, None, True),
        KeyError("key"),
        FileNotFoundError(2, "No such file", "name.txt"),
        UnknownNameError("no task"),
        MemoryError(),
    ],
)
def test_built_in_exceptions_and_the_packages_own_keep_everything(error: Exception) -> None:
    error.add_note("in environment 2")
    copy = sent(error)
    assert (type(copy), copy.args, str(copy)) == (type(error), error.args, str(error))
    assert copy.__notes__ == ["in environment 2"]
    assert isinstance(copy.__cause__, WorkerTraceback)


def test_a_class_is_known_by_its_module_too() -> None:
    class WorkerDiedError(Exception):  # of another module than the package's
        pass

    copy = sent(WorkerDiedError("fell ill"))
    assert type(copy) is WorkerError
    assert "WorkerDiedError: fell ill" in str(copy)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("foreign", "Odd: 1, <function"),
        ("mute", "Mute: text"),
        ("group", "ExceptionGroup: several, [<ValueError>, <TypeError>]"),
        ("unicode", "UnicodeDecodeError: utf-8, b'\\xff', 0, 1, invalid start byte"),
    ],
)
def test_others_are_named(kind: str, message: str) -> None:
    copy = sent(raised(work.raise_error, kind))
    assert type(copy) is WorkerError
    assert str(copy).startswith(message)


def test_texts_are_of_bounded_length() -> None:
    huge = sent(raised(work.raise_error, "huge"))
    assert type(huge) is ValueError
    assert huge.args[0].startswith("xxx")
    assert "(49998000 characters left out)" in huge.args[0]
    assert huge.args[1] == "<integer of 16610 bits>"
    assert len(str(huge.__cause__)) < 25_000
    assert len(sent(raised(work.raise_error, "many")).args) == 10


def test_notes_of_any_kind() -> None:
    long, number = sent(raised(work.raise_with_notes, "text")).__notes__
    assert len(long) < 5_000
    assert number == "5"
    assert not hasattr(sent(raised(work.raise_with_notes, "none")), "__notes__")


def test_a_nesting_too_deep() -> None:
    error: Exception = ValueError("inmost")
    for _ in range(5000):
        error = ExceptionGroup("outer", [error])
    copy = sent(error)
    assert type(copy) is WorkerError
    assert str(copy).startswith("ExceptionGroup: ")
    assert len(str(copy)) < 10_000


def test_the_error_of_a_dead_worker_is_the_packages() -> None:
    assert type(sent(WorkerDiedError("ended"))) is WorkerDiedError
