"""Reading a published file that ends the process, or raises an unexpected exception."""

import os
import signal
from pathlib import Path
from typing import Any

from magical.demos.human import importing
from magical.demos.store.manifest import ManifestEntry


def convert(file: Path, **options: Any) -> tuple[ManifestEntry, bytes, str | None]:
    if file.name.startswith("segfault"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if file.name.startswith("exit"):
        os._exit(3)
    if file.name.startswith("memory"):
        raise MemoryError("no room")
    return importing._convert(file, **options)
