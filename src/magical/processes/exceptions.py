"""Exceptions on their way from a child process to its parent, as plain data of bounded size."""

import builtins
import traceback
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from magical import errors
from magical.errors import WorkerError

MAX_TEXT = 4_000  # characters kept of a message, an argument or a note
MAX_TRACEBACK = 20_000  # characters kept of a traceback
MAX_COUNT = 10  # arguments kept, and notes
_MODULES = {"builtins": builtins, "magical.errors": errors}  # whose exceptions are rebuilt


class WorkerTraceback(Exception):
    """The traceback of an exception in a child process, as text; the cause of `rebuild`'s."""

    def __str__(self) -> str:
        return f"in a worker process:\n\n{self.args[0]}"


def describe(error: Exception) -> dict[str, Any]:
    """An exception as data for JSON or pickle, whatever it holds, for `rebuild`."""
    kind = type(error)
    data = {"module": _text(kind.__module__), "name": _text(kind.__qualname__)}
    try:
        notes = getattr(error, "__notes__", [])
        return {
            **data,
            "arguments": [_plain(argument) for argument in _arguments(error)[:MAX_COUNT]],
            "notes": [_text(note) for note in notes[:MAX_COUNT]] if type(notes) is list else [],
            "traceback": _shorten("".join(traceback.format_exception(error)), MAX_TRACEBACK),
        }
    except Exception as other:  # of the exception's own methods, or too deep a nesting
        why = f"(its description failed: {type(other).__name__})"
        return {**data, "arguments": [why], "notes": [], "traceback": why}


def rebuild(data: Mapping[str, Any]) -> Exception:
    """The exception that `describe` has described, with a `WorkerTraceback` as its cause.

    A built-in exception and one of `magical.errors` keep their class; any other, and one that
    cannot be made of plain arguments, becomes a `WorkerError` that names its class.
    """
    error: Exception = WorkerError(f"{data['name']}: {', '.join(map(str, data['arguments']))}")
    kind = getattr(_MODULES.get(data["module"]), data["name"], None)
    if isinstance(kind, type) and issubclass(kind, Exception):
        with suppress(Exception):  # its constructor expects other arguments
            error = kind(*data["arguments"])
    for note in data["notes"]:
        error.add_note(note)
    error.__cause__ = WorkerTraceback(data["traceback"])
    return error


def _arguments(error: Exception) -> tuple[Any, ...]:
    """What to call the class with; `args` of an `OSError` are without its file's name."""
    return tuple(OSError.__reduce__(error)[1]) if isinstance(error, OSError) else error.args


def _plain(argument: Any) -> Any:
    plain = argument is None or type(argument) in (bool, float)
    small = type(argument) is int and abs(argument) < 1 << 63
    return argument if plain or small else _text(argument)


def _text(value: object) -> str:
    try:
        return _shorten(str(value), MAX_TEXT)
    except Exception:
        return f"({type(value).__name__} that cannot be printed)"


def _shorten(text: str, limit: int) -> str:
    """A text without its middle if it is long: a traceback's end says most."""
    if len(text) <= limit:
        return text
    half = limit // 2
    return f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"
