"""Reading recordings safely, writing results in one go."""

import gzip
import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from magical.errors import RecordingError


def read_json(path: Path | str) -> Any:
    """Read JSON, gzipped or not; raises `RecordingError` naming the file."""
    try:
        raw = Path(path).read_bytes()
        return json.loads(gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    except (EOFError, ValueError) as error:
        raise RecordingError(f"{path}: expected JSON (perhaps gzipped), found {error}") from error


def write_text(path: Path | str, text: str) -> None:
    """Write a text file under a temporary name, then rename it."""
    write_atomically(path, lambda file: file.write(text.encode()))


def write_atomically(path: Path | str, fill: Callable[[IO[bytes]], Any]) -> None:
    """Let `fill` write a file under a temporary name in the same folder, then rename it."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            fill(file)
        os.chmod(name, 0o644)
        os.replace(name, target)
    except BaseException:
        os.unlink(name)
        raise
