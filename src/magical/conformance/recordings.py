"""Recordings: where those in the package are, how files are read and written, comparisons."""

import gzip
import hashlib
import json
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from magical.errors import MagicalError, RecordingError
from magical.files import write_atomically

DATA = Path(__file__).parent / "data"
SUMS = "SHA256SUMS"  # in the format of `sha256sum`
RECORDINGS = {
    "frames": ("frames-96.npz", "frames-384.npz"),
    "motions": ("motions.json",),
    "scenes": ("scenes.json.gz",),
    "scores": ("scores.json.gz",),
}


@dataclass(frozen=True, slots=True)
class Comparison:
    """One figure, its limit, and whether it keeps to the limit."""

    name: str
    figure: float
    limit: float
    unit: str
    passed: bool
    detail: str = ""

    @classmethod
    def at_most(cls, name: str, figure: float, limit: float, unit: str, detail: str = "") -> Self:
        """The comparison of a figure that passes up to `limit`."""
        return cls(name, figure, limit, unit, figure <= limit, detail)

    @classmethod
    def at_least(cls, name: str, figure: float, limit: float, unit: str, detail: str = "") -> Self:
        """The comparison of a figure that passes from `limit` upwards."""
        return cls(name, figure, limit, unit, figure >= limit, detail)


def read_json(path: Path | str, *kinds: type) -> Any:
    """Read a dict or a list as JSON, gzipped or not; raises `RecordingError` for anything else."""
    try:
        raw = Path(path).read_bytes()
        data = json.loads(gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    except (EOFError, ValueError, zlib.error) as error:
        raise RecordingError(f"{path}: expected JSON (perhaps gzipped), found {error}") from error
    if not isinstance(data, kinds):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise RecordingError(f"{path}: expected a {names}, found {type(data).__name__}")
    return data


def write_json(computed: Any, out: Path | str) -> None:
    """Write what was computed as JSON."""
    with write_atomically(out) as file:
        file.write(json.dumps(computed).encode())


@contextmanager
def expecting(path: Path | str, expected: str) -> Iterator[None]:
    """Errors in the block become a `RecordingError` that says what the file should hold."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, MagicalError) as error:
        raise RecordingError(f"{path}: expected {expected}; found: {error!r}") from error


def recording_path(name: str) -> Path:
    """The path of a recording in the package.

    Raises:
        RecordingError: The file, or the list of SHA-256 sums beside it, is missing or damaged.
    """
    path = DATA / name
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
        expected = _sums().get(name, "none")
    except OSError as error:
        raise _damaged(path, f"cannot be read: {error}") from error
    if found != expected:
        raise _damaged(path, f"expected SHA-256 {expected} ({SUMS}), found {found}")
    return path


def _sums() -> dict[str, str]:
    """The SHA-256 of each recording by its file name."""
    lines = (DATA / SUMS).read_text(encoding="utf-8", errors="replace").splitlines()
    words = (line.split() for line in lines)
    return {pair[1]: pair[0] for pair in words if len(pair) == 2}


def _damaged(path: Path, found: str) -> RecordingError:
    return RecordingError(
        f"{path}: {found}. This file belongs to the package: reinstall the package, or in a clone "
        f"restore the folder {path.parent.name} with git"
    )
