"""Exceptions on their way from a child process to its parent, as plain data of bounded size."""

import builtins
import traceback
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import islice
from typing import Any

from magical import errors
from magical.errors import WorkerError
from magical.messages import printable, quoted

MAX_TEXT = 2_000  # characters kept of a message, an argument or a note
MAX_TRACEBACK = 20_000  # characters kept of a traceback
MAX_COUNT = 10  # arguments kept, and notes, and exceptions that led to this one
_MODULES = {"builtins": builtins, "magical.errors": errors}  # whose exceptions are rebuilt


class WorkerTraceback(Exception):
    """The traceback of an exception in a child process, as text; the cause of `rebuild`'s."""

    def __str__(self) -> str:
        return f"in a worker process:\n\n{self.args[0]}"


def describe(error: Exception) -> dict[str, Any]:
    """An exception as data for JSON, whatever it holds, for `rebuild`.

    Its `__str__` and `__repr__` are not called: they could fail, or take for ever.
    """
    notes = getattr(error, "__notes__", None)
    return {
        "module": printable(type(error).__module__),
        "name": printable(type(error).__qualname__),
        "arguments": [_plain(argument) for argument in _arguments(error)[:MAX_COUNT]],
        "notes": [_text(note) for note in notes[:MAX_COUNT]] if type(notes) is list else [],
        "traceback": _shortened("".join(_traceback(error)), MAX_TRACEBACK),
    }


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


def _arguments(error: BaseException) -> tuple[Any, ...]:
    """What to call the class with; `args` of an `OSError` are without its file's name."""
    kind = OSError if isinstance(error, OSError) else BaseException
    return tuple(kind.__reduce__(error)[1])


def _traceback(error: BaseException) -> Iterator[str]:
    """The lines of a traceback, with those of the exceptions that led to it before it."""
    for link in reversed(list(islice(_chain(error), MAX_COUNT))):
        yield "Traceback (most recent call last):\n"
        yield from traceback.format_tb(link.__traceback__)
        arguments = ", ".join(map(_text, _arguments(link)[:MAX_COUNT]))
        yield f"{type(link).__qualname__}: {arguments}\n\n"


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def _plain(argument: Any) -> Any:
    plain = argument is None or type(argument) in (bool, float)
    small = type(argument) is int and argument.bit_length() < 64
    return argument if plain or small else _text(argument)


def _text(value: Any) -> str:
    """Strings keep their line breaks; anything else is bounded and printable."""
    return _shortened(value, MAX_TEXT) if type(value) is str else quoted(value)


def _shortened(text: str, limit: int) -> str:
    """A text without its middle if it is long: a traceback's end says most."""
    if len(text) <= limit:
        return text
    half = limit // 2
    return f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"
