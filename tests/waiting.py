"""Waiting for conditions and for the end of processes, without sleeping."""

import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path


def alive(process_id: int) -> bool:
    """Whether a process runs; one that has ended and waits to be collected does not.

    For tests marked `linux`, since it reads /proc.
    """
    assert sys.platform == "linux"
    try:
        state = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def soon(condition: Callable[[], bool], seconds: float = 5.0) -> bool:
    """Whether a condition comes true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0)  # lets others run
    return condition()


def gone(process_ids: Iterable[int]) -> bool:
    """Whether all processes end in time."""
    return soon(lambda: not any(map(alive, process_ids)))
