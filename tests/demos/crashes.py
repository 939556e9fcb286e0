"""Reading a published file that ends the process, or fails in a way that was not foreseen."""

import os
import signal
from pathlib import Path

from magical.demos import importing
from magical.demos.manifest import Entry


def convert(file: Path, max_bytes: int) -> tuple[Entry, bytes]:
    if file.name.startswith("segfault"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if file.name.startswith("exit"):
        os._exit(3)
    if file.name.startswith("memory"):
        raise MemoryError("no room")
    return importing._convert(file, max_bytes)
