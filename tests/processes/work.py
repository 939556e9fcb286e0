"""Work for child processes."""

import os
import signal
from pathlib import Path


def process_id(item: object) -> int:
    return os.getpid()


def kill_at(bad: int, item: int) -> int:
    """The item; the process is killed at the bad one."""
    if item == bad:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def raise_error(item: int) -> None:
    raise KeyError(item)


def wait_for_ever(folder: str) -> None:
    """Leave the process id as a file's name, then wait for a signal."""
    (Path(folder) / str(os.getpid())).touch()
    signal.pause()
