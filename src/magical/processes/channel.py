"""Messages between a process and its children, exceptions included: pickled over pipes."""

import pickle
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any

from magical.errors import WorkerError

_REBUILT = ("builtins", "magical.errors")  # modules whose exceptions keep their class


class WorkerTraceback(Exception):
    """The traceback of an exception in a child process, as text; the exception's cause."""

    def __str__(self) -> str:
        return f"in a worker process:\n\n{self.args[0]}"


def send(pipe: IO[bytes], message: bytes) -> None:
    """Write a pickled value; raises `BrokenPipeError` if the other process has ended."""
    pickle.dump(message, pipe)  # as bytes: a value that cannot be unpickled leaves the pipe usable
    pipe.flush()


def receive(pipe: IO[bytes]) -> bytes:
    """Read a pickled value; raises `EOFError` if the other process has ended."""
    try:
        message: bytes = pickle.load(pipe)  # noqa: S301  (our own child's or parent's)
    except pickle.UnpicklingError as error:  # ended within the message
        raise EOFError from error
    return message


def receive_result(pipe: IO[bytes]) -> tuple[bool, Any]:
    """What `serve` has sent: True and the result, or False and the exception.

    The exception's cause is a `WorkerTraceback`. Raises `EOFError` if the child has ended.
    """
    succeeded, value, text = pickle.loads(receive(pipe))  # noqa: S301  (our own child's)
    if not succeeded:
        value.__cause__ = WorkerTraceback(text)
    return succeeded, value


def serve(
    answer: Callable[[Any], Any],
    requests: IO[bytes],
    replies: IO[bytes],
    after: Callable[[], None] | None = None,
) -> None:
    """The child's side: answer one request after another until the parent closes the pipes.

    Args:
        answer: maps a request to its result; its exceptions are sent to the parent.
        requests: the pipe to read from.
        replies: the pipe to write to.
        after: called after each reply.
    """
    while True:
        request = receive(requests)
        try:
            message = pickle.dumps((True, answer(pickle.loads(request)), ""))  # noqa: S301
        except Exception as error:
            text = "".join(traceback.format_exception(error))
            message = pickle.dumps((False, _sendable(error), text))
        send(replies, message)
        if after is not None:
            after()


def _sendable(error: Exception) -> Exception:
    """The exception itself, or a `WorkerError` that names it if the parent might not know it."""
    if type(error).__module__ in _REBUILT:
        with suppress(Exception):  # arguments that cannot be pickled, or that do not rebuild it
            pickle.loads(pickle.dumps(error))  # noqa: S301
            return error
    named = WorkerError(traceback.format_exception_only(error)[0].strip())
    for note in getattr(error, "__notes__", ()):
        named.add_note(str(note))
    return named
