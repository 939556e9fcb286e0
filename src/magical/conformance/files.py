"""Safe reading of recording files."""

import gzip
import json
import zlib
from pathlib import Path
from typing import Any

from magical.errors import RecordingError


def read_json(path: Path | str) -> Any:
    """Read JSON, gzipped or not.

    Raises:
        RecordingError: The file cannot be read or is not JSON.
    """
    try:
        raw = Path(path).read_bytes()
        return json.loads(gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    except (EOFError, ValueError, zlib.error) as error:
        raise RecordingError(f"{path}: expected JSON (perhaps gzipped), found {error}") from error
