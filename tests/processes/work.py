"""Work for child processes."""

import itertools
import os
import signal
import sys
from pathlib import Path
from typing import Any

from magical.errors import UnknownNameError


class Foreign(Exception):
    """An exception that can be neither pickled nor printed."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(first, lambda: second)


class Unprintable(Exception):
    """An exception whose methods fail."""

    def __str__(self) -> str:
        raise RuntimeError

    def __reduce__(self) -> Any:
        raise RuntimeError


def exit_at(bad: int, item: int) -> tuple[int, int]:
    """The item and the process id; the process ends at the bad item."""
    if item == bad:
        os._exit(7)
    return item, os.getpid()


def kill_itself(number: int) -> None:
    os.kill(os.getpid(), number)


def raise_error(kind: str) -> None:
    namesake = type("ValueError", (Exception,), {"__module__": "elsewhere"})
    error = {
        "value": ValueError("not this one", 3),
        "file": FileNotFoundError(2, "No such file", "name.txt"),
        "package": UnknownNameError("no task"),
        "foreign": Foreign(1, 2),
        "unprintable": Unprintable("text"),
        "argument": ValueError(lambda: 1),
        "namesake": namesake("text"),
    }[kind]
    error.add_note("in environment 2")
    raise error


class OneWay:
    """What can be pickled and not be made again."""

    def __reduce__(self) -> Any:
        return divmod, (1, 0)


def one_way(wanted: bool) -> Any:
    return OneWay() if wanted else wanted


def large(size: int) -> bytes:
    """Bytes, more than a pipe holds."""
    return b"\x01" * size


def not_to_be_pickled(item: int) -> Any:
    return lambda: item


def print_and_read(item: str) -> tuple[str, dict[str, str]]:
    """Print, read standard input; the environment."""
    print(item)
    return sys.stdin.read(), dict(os.environ)


def compute_for_ever(folder: str) -> None:
    """Leave the process id as a file's name, then let no thread run; return without a folder."""
    if folder:
        (Path(folder) / str(os.getpid())).touch()
        _ = -1 in itertools.count()


def wait_for_sigterm(file: str) -> str:
    """Create a file, wait for SIGTERM; how it was received."""
    received = []
    signal.signal(signal.SIGTERM, lambda number, frame: received.append(number))
    Path(file).touch()
    while not received:
        pass
    return f"received {received}"


def wait_for_ever(folder: str) -> None:
    """Leave the process id as a file's name, then wait for a signal; return without a folder."""
    if folder:
        (Path(folder) / str(os.getpid())).touch()
        signal.pause()
