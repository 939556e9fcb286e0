"""The manifest of a dataset: a JSON Lines file with one line for each trajectory, append-only.

Every line ends with a checksum of itself and the line before it, which reveals a changed, missing
or moved line. A manifest that was cut off at the end of a line is revealed by the trajectory files
that it does not list.
"""

import hashlib
import itertools
import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import IO, Any, NamedTuple

from magical.demos.store.codec import MAX_FILE, MAX_STEPS, fingerprint
from magical.demos.store.trajectory import MAX_NAME, Trajectory
from magical.envs.ids import EnvId, split_env_id
from magical.errors import DatasetError, MagicalError
from magical.files import open_regular
from magical.messages import quoted
from magical.untrusted import check_plain

NAME = "manifest.jsonl"
FOLDER = "trajectories"
HEADER = {"format": "magical-dataset", "version": 1}
MAX_LINE = 1 << 16  # bytes; names of `MAX_NAME` characters fit
MAX_DAMAGED_LINES = 1000  # then the rest of the manifest is not read
_SHA256 = re.compile("[0-9a-f]{64}")
_FINGERPRINT = re.compile("[0-9a-f]{16}")
_NAME = re.compile(r"\w{1,100}")  # a task or variant, as part of a file's name


@dataclass(frozen=True, slots=True, kw_only=True)
class ManifestEntry:
    """One line of the manifest: the file of a trajectory, and its properties.

    Raises:
        ValueError: a field is of another type or outside its range.
        UnknownNameError: `env_id` is not an environment id.
    """

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
    fingerprint: str  # equal for equal actions and poses or frames
    source: str | None = None  # the file it was imported from
    source_sha256: str | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not _CHECKS[field.name](value):
                raise ValueError(f"{field.name}: the format does not allow {quoted(value)}")
        # Names are not looked up: a task of another package may not be registered here.
        env_id = split_env_id(self.env_id)
        if not (_NAME.fullmatch(env_id.task) and _NAME.fullmatch(env_id.variant)):
            raise ValueError(
                f"env_id: expected names of letters and digits, found {quoted(env_id)}"
            )
        object.__setattr__(self, "env_id", env_id)
        if self.file != _file(self.index, self.env_id):
            raise ValueError(
                f"expected the name of trajectory {self.index}, found {quoted(self.file)}"
            )

    @staticmethod
    def of(trajectory: Trajectory, raw: bytes, index: int = 0) -> "ManifestEntry":
        """The entry of a trajectory whose file has the bytes `raw`."""
        source, source_sha256 = (trajectory.metadata.get(n) for n in ("source", "source_sha256"))
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
            source=source if _is_name(source) else None,
            source_sha256=source_sha256 if _is_sha256(source_sha256) else None,
        )

    def at(self, index: int) -> "ManifestEntry":
        """The entry with another index."""
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


def _is_name(value: object) -> bool:
    return isinstance(value, str) and 0 < len(value) <= MAX_NAME


def _is_sha256(value: object) -> bool:
    return isinstance(value, str) and _SHA256.fullmatch(value) is not None


def _is_score(value: object) -> bool:
    return type(value) is float and 0.0 <= value <= 1.0


_CHECKS: dict[str, Callable[[object], bool]] = {
    "index": lambda value: type(value) is int and 0 <= value < 10**9,
    "file": _is_name,
    "sha256": _is_sha256,
    "size": lambda value: type(value) is int and 0 < value <= MAX_FILE,
    "env_id": _is_name,
    "length": lambda value: type(value) is int and 0 < value <= MAX_STEPS,
    "score": lambda value: value is None or _is_score(value),
    "published_code_score": _is_score,
    "demonstrator": _is_name,
    "seed": lambda value: value is None or (type(value) is int and value >= 0),
    "has_poses": lambda value: type(value) is bool,
    "fingerprint": lambda value: isinstance(value, str) and bool(_FINGERPRINT.fullmatch(value)),
    "source": lambda value: value is None or _is_name(value),
    "source_sha256": lambda value: value is None or _is_sha256(value),
}


def new_text(entries: list[ManifestEntry]) -> str:
    """The text of a new manifest."""
    lines, check = [], ""
    for content in (HEADER, *map(asdict, entries)):
        line, check = _line(content, check)
        lines.append(line)
    return "".join(lines)


def read_entries(folder: Path) -> Iterator[ManifestEntry | DatasetError]:
    """The manifest's entries in order; for a damaged line, the error instead of the entry.

    Raises:
        DatasetError: there is no manifest, or it cannot be read.
    """
    path = folder / NAME
    try:
        with open_regular(path) as file:
            yield from _parse_lines(path, file)
    except FileNotFoundError as error:
        raise DatasetError(f"{folder}: expected a dataset, found no {NAME} in it") from error
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror or error}") from error


def _parse_lines(path: Path, file: IO[bytes]) -> Iterator[ManifestEntry | DatasetError]:
    check, damaged = "", 0
    for number in itertools.count(1):
        line = file.readline(MAX_LINE)
        if not line and number > 1:
            return
        parsed = _parse(line, check)
        check = parsed.check
        if not parsed.intact or (number == 1) != (parsed.entry is None):
            damaged += 1
            yield DatasetError(f"{path}: line {number} or the line before it is damaged; {ADVICE}")
        elif parsed.entry:
            yield parsed.entry
        if damaged == MAX_DAMAGED_LINES:
            yield DatasetError(f"{path}: more than {damaged} damaged lines; {ADVICE}")
            return


ADVICE = "`magical demos info DIR --repair` rebuilds the manifest from the intact trajectories"


def append(folder: Path, entry: ManifestEntry, check: str) -> None:
    """Append a line; `check` is the last line's checksum. On failure the file stays as it was.

    Raises:
        OSError: the file cannot be written, or the disk is full.
    """
    line, _ = _line(asdict(entry), check)
    with open_regular(folder / NAME, "r+b", buffering=0) as file:
        size = file.seek(0, os.SEEK_END)
        try:
            _write_all(file, line.encode())
        except BaseException:
            file.truncate(size)
            raise


def last_line(folder: Path) -> tuple[int, str]:
    """The next free index, and the last line's checksum.

    Raises:
        DatasetError: the last line is damaged.
        OSError: the manifest cannot be read.
    """
    path = folder / NAME
    with open_regular(path) as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - MAX_LINE))
        lines = file.read(MAX_LINE).splitlines(keepends=True)
    last = _parse(lines[-1] if lines else b"", None)
    if not last.intact or not last.check:
        raise DatasetError(f"{path}: the last line is damaged; {ADVICE}")
    return last.entry.index + 1 if last.entry else 0, last.check


def _line(content: dict[str, Any], previous: str) -> tuple[str, str]:
    body = json.dumps(content, separators=(",", ":"))
    check = hashlib.sha256((previous + body).encode()).hexdigest()[:32]
    return f'{body[:-1]},"check":"{check}"}}\n', check


class _ParsedLine(NamedTuple):
    entry: ManifestEntry | None = None  # None: the header
    check: str = ""
    intact: bool = False


def _parse(line: bytes, previous: str | None) -> _ParsedLine:
    """Parse a line, and compare it with what is written after a line of checksum `previous`."""
    try:
        text = line.decode()
        content = json.loads(text)
        check_plain(content)
        check = content.pop("check")
        if not isinstance(check, str):
            return _ParsedLine()
        intact = text.endswith("\n") and (previous is None or _line(content, previous)[0] == text)
        if content == HEADER:
            return _ParsedLine(None, check, intact)
        return _ParsedLine(ManifestEntry(**content), check, intact)
    except (AttributeError, LookupError, MagicalError, RecursionError, TypeError, ValueError):
        return _ParsedLine()


def _write_all(file: Any, data: bytes) -> None:
    while data:
        data = data[file.write(data) :]
