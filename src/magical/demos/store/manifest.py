"""A dataset's list of contents: one line of JSON a trajectory, only ever appended to.

Every line ends with a check sum over itself and the line before, so that a changed, lost or moved
line shows. An end that was cut off shows as trajectory files that are not listed.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from magical.demos.store.codec import fingerprint
from magical.demos.store.trajectory import Trajectory
from magical.envs.ids import EnvId, split_env_id
from magical.errors import DatasetError

NAME = "manifest.jsonl"
FOLDER = "trajectories"
LOCK = ".lock"
HEADER = {"format": "magical-dataset", "version": 1}
_TAIL = 1 << 20  # bytes: more than any line has


@dataclass(frozen=True, slots=True, kw_only=True)
class ManifestEntry:
    """What the manifest knows of one trajectory."""

    index: int
    file: str  # relative to the dataset's folder
    sha256: str
    size: int  # bytes
    env_id: EnvId
    length: int  # control steps
    score: float | None
    published_code_score: float
    demonstrator: str
    seed: int | None
    has_poses: bool
    fingerprint: str  # the same for the same actions and poses or frames
    source: str | None = None  # file that it was imported from
    source_sha256: str | None = None

    def __post_init__(self) -> None:
        # Names are not looked up: a task of another package may not be registered here.
        object.__setattr__(self, "env_id", split_env_id(self.env_id))
        if self.file != _file(self.index, self.env_id):
            raise ValueError(f"expected the name of trajectory {self.index}, found {self.file!r}")

    @staticmethod
    def of(trajectory: Trajectory, raw: bytes, index: int = 0) -> "ManifestEntry":
        """The entry of a trajectory whose file has the bytes `raw`."""
        return ManifestEntry(
            index=index,
            file=_file(index, trajectory.env_id),
            sha256=hashlib.sha256(raw).hexdigest(),
            size=len(raw),
            env_id=trajectory.env_id,
            length=len(trajectory),
            score=trajectory.score,
            published_code_score=trajectory.published_code_score,
            demonstrator=trajectory.demonstrator,
            seed=trajectory.seed,
            has_poses=trajectory.poses is not None,
            fingerprint=fingerprint(raw),
            source=trajectory.metadata.get("source"),
            source_sha256=trajectory.metadata.get("source_sha256"),
        )

    def at(self, index: int) -> "ManifestEntry":
        """The same at another place in the dataset."""
        return replace(self, index=index, file=_file(index, self.env_id))

    @property
    def final_score(self) -> float:
        """The appendix's score, or where poses are unknown the published code's."""
        return self.published_code_score if self.score is None else self.score

    @property
    def task(self) -> str:
        """The task's name."""
        return self.env_id.task

    @property
    def variant(self) -> str:
        """The variant's name."""
        return self.env_id.variant


def _file(index: int, env_id: EnvId) -> str:
    return f"{FOLDER}/{index:06d}-{env_id.task}-{env_id.variant}.npz"


def new_text(entries: list[ManifestEntry]) -> str:
    """A whole manifest's text."""
    lines, check = [], ""
    for content in (HEADER, *map(asdict, entries)):
        line, check = _line(content, check)
        lines.append(line)
    return "".join(lines)


def read_entries(folder: Path) -> Iterator[ManifestEntry | DatasetError]:
    """The manifest's entries in order; in the place of a damaged line, the error that it is."""
    path = folder / NAME
    try:
        lines = path.read_bytes().decode(errors="replace").splitlines(keepends=True)
    except FileNotFoundError as error:
        raise DatasetError(f"{folder}: expected a dataset, found no {NAME} in it") from error
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error
    check = ""
    for number, line in enumerate(lines or [""], 1):
        content, good = _parse(line, check)
        check = str(content.pop("check", ""))
        expected = HEADER if number == 1 else None
        if not good or (expected and content != expected):
            yield DatasetError(f"{path}: line {number} is damaged, or the line before it; {ADVICE}")
        elif not expected:
            yield ManifestEntry(**content)


ADVICE = "`magical demos info DIR --repair` lists the intact trajectories anew"


def append(folder: Path, entry: ManifestEntry, check: str) -> None:
    """Add a line; `check` is the last line's. On failure the file is as it was.

    Raises:
        OSError: the file cannot be written, or the disk is full.
    """
    line, _ = _line(asdict(entry), check)
    with (folder / NAME).open("r+b", buffering=0) as file:
        size = file.seek(0, os.SEEK_END)
        try:
            _write_all(file, line.encode())
        except BaseException:
            file.truncate(size)
            raise


def last_line(folder: Path) -> tuple[int, str]:
    """The next free index, and the last line's check sum.

    Raises `DatasetError` if that line is damaged.
    """
    path = folder / NAME
    with path.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
        lines = file.read().decode(errors="replace").splitlines(keepends=True)
    content, good = _parse(lines[-1] if lines else "", None)
    if not good or "check" not in content:
        raise DatasetError(f"{path}: the last line is damaged; {ADVICE}")
    return int(content.get("index", -1)) + 1, str(content["check"])


def _line(content: dict[str, Any], previous: str) -> tuple[str, str]:
    body = json.dumps(content, separators=(",", ":"))
    check = hashlib.sha256((previous + body).encode()).hexdigest()[:32]
    return f'{body[:-1]},"check":"{check}"}}\n', check


def _parse(line: str, previous: str | None) -> tuple[dict[str, Any], bool]:
    """A line's content and whether it is exactly what was written after `previous`."""
    try:
        content = json.loads(line)
        plain = {name: value for name, value in content.items() if name != "check"}
        good = previous is None or _line(plain, previous)[0] == line
        if good and "index" in content:
            ManifestEntry(**plain)
        return content, good and line.endswith("\n")
    except (AttributeError, IndexError, TypeError, ValueError):
        return {}, False


def _write_all(file: Any, data: bytes) -> None:
    while data:
        data = data[file.write(data) :]
