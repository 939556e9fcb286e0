"""Recordings of the published environments: their files, reading, writing, comparisons."""

import gzip
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import msgspec

from magical.files import write_atomically
from magical.scene import Scene

DATA = Path(__file__).parent / "data"
RECORDINGS = {
    "frames": ("frames-96.npz", "frames-384.npz"),
    "motions": ("motions.json",),
    "scenes": ("scenes.json.gz",),
    "scores": ("scores.json.gz",),
}


class RecordingError(ValueError):
    """A recording file that is damaged or not in the documented format."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One figure, its limit, and whether the figure passes."""

    name: str
    figure: float
    limit: float
    unit: str
    passed: bool
    detail: str = ""

    @classmethod
    def at_most(cls, name: str, figure: float, limit: float, unit: str, detail: str = "") -> Self:
        """A comparison that passes if the figure is at most `limit`."""
        return cls(name, figure, limit, unit, figure <= limit, detail)


def scene_of(record: Mapping[str, Any]) -> Scene:
    """The scene of a record, which may have other fields."""
    names = {field.name for field in fields(Scene)}
    return Scene.from_dict({name: value for name, value in record.items() if name in names})


def read_json(path: Path | str, kind: Any) -> Any:
    """Read JSON as type `kind`, gzipped or not; for use within `expecting`."""
    raw = Path(path).read_bytes()
    return msgspec.json.decode(gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw, type=kind)


def write_json(computed: Any, out: Path | str) -> None:
    """Write what was computed as JSON."""
    with write_atomically(out) as file:
        file.write(json.dumps(computed).encode())


@contextmanager
def expecting(path: Path | str, expected: str) -> Iterator[None]:
    """Turn errors in the block into a `RecordingError` that says what the file should hold."""
    try:
        yield
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    except Exception as error:  # a damaged file can raise anything
        raise RecordingError(f"{path}: expected {expected}; found: {error!r}") from error
