"""Recordings of the published environments: their files, reading, writing, comparisons."""

import gzip
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

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


class Comparison(NamedTuple):
    """One figure, its limit, and whether the figure passes: it is at most, or `at_least`, that."""

    name: str
    figure: float
    limit: float
    unit: str
    detail: str
    at_least: bool = False

    @property
    def passed(self) -> bool:
        return self.figure >= self.limit if self.at_least else self.figure <= self.limit


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
