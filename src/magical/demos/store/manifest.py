"""The manifest of a dataset: an append-only JSON Lines file with one line for each trajectory.

Every line ends with a checksum of itself and the line before it, which reveals a changed, missing
or moved line. A manifest that was cut off at the end of a line is revealed by the trajectory files
that it does not list.
"""

import hashlib
import itertools
import json
import os
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Annotated, Any, NamedTuple

from msgspec import Meta

from magical.demos.store.codec import MAX_FILE, MAX_STEPS, encode, fingerprint
from magical.demos.store.trajectory import MAX_NAME, Trajectory
from magical.envs.ids import EnvId, split_env_id
from magical.errors import DatasetError, MagicalError
from magical.files import open_regular, reading
from magical.messages import quoted
from magical.untrusted import convert

NAME = "manifest.jsonl"
FOLDER = "trajectories"
HEADER = {"format": "magical-dataset", "version": 1}
MAX_LINE = 1 << 16  # bytes; names of `MAX_NAME` characters fit
MAX_DAMAGED_LINES = 1000  # after these, the rest of the manifest is not read
_SHA256 = r"\A[0-9a-f]{64}\Z"
_NAME = rf"\A(?s:.){{1,{MAX_NAME}}}\Z"
_FILE_NAME = re.compile(r"\w{1,100}")  # a task or variant, as part of a file's name

Name = Annotated[str, Meta(pattern=_NAME)]
Sha256 = Annotated[str, Meta(pattern=_SHA256)]
Score = Annotated[float, Meta(ge=0.0, le=1.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ManifestEntry:
    """One line of the manifest: the file of a trajectory, and its properties.

    Raises:
        ValueError: the environment's names do not fit into a file name, or `file` has another name.
    """

    index: Annotated[int, Meta(ge=0, lt=10**9)]
    file: str  # relative to the dataset's folder
    sha256: Sha256
    size: Annotated[int, Meta(gt=0, le=MAX_FILE)]  # bytes
    env_id: EnvId
    length: Annotated[int, Meta(gt=0, le=MAX_STEPS)]  # control steps
    score: Score | None
    published_code_score: Score
    demonstrator: Name
    seed: Annotated[int, Meta(ge=0)] | None
    has_poses: bool
    # equal for equal actions and poses or frames
    fingerprint: Annotated[str, Meta(pattern=r"\A[0-9a-f]{16}\Z")]
    source: Name | None = None  # the file it was imported from
    source_sha256: Sha256 | None = None

    def __post_init__(self) -> None:
        for name in (self.env_id.task, self.env_id.variant):
            if not _FILE_NAME.fullmatch(name):
                raise ValueError(
                    f"env_id: expected names of letters and digits, found {quoted(self.env_id)}"
                )
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
            source=_matching(_NAME, source),
            source_sha256=_matching(_SHA256, source_sha256),
        )

    def at(self, index: int) -> "ManifestEntry":
        """The entry with another index."""
        return replace(self, index=index, file=_file(index, self.env_id))

    @property
    def final_score(self) -> float:
        """The appendix's score, or the published code's if poses are unknown."""
        return self.published_code_score if self.score is None else self.score

    @property
    def task(self) -> str:
        """The task's name."""
        return self.env_id.task

    @property
    def variant(self) -> str:
        """The variant's name."""
        return self.env_id.variant


def encoded(trajectory: Trajectory) -> tuple[ManifestEntry, bytes]:
    """A trajectory's entry and its file's bytes; raises `TrajectoryError` as `encode` does."""
    raw = encode(trajectory)
    return ManifestEntry.of(trajectory, raw), raw


def _file(index: int, env_id: EnvId) -> str:
    return f"{FOLDER}/{index:06d}-{env_id.task}-{env_id.variant}.npz"


def _matching(pattern: str, value: object) -> str | None:
    """The value if it is text that matches."""
    return value if isinstance(value, str) and re.search(pattern, value) else None


def new_text(entries: list[ManifestEntry]) -> str:
    """The text of a new manifest."""
    lines, check = [], ""
    for content in (HEADER, *map(asdict, entries)):
        line, check = _line(content, check)
        lines.append(line)
    return "".join(lines)


def read_entries(folder: Path) -> tuple[list[ManifestEntry], list[str]]:
    """The manifest's entries in order, and a message for each damaged line.

    Raises:
        DatasetError: there is no manifest, or it cannot be read.
    """
    path = folder / NAME
    if not os.path.lexists(path):
        found = f"no {NAME} in it" if folder.is_dir() else "no folder"
        raise DatasetError(f"{folder}: expected a dataset, found {found}")
    with reading(path, DatasetError), open_regular(path) as file:
        return _parse_lines(path, file)


def _parse_lines(path: Path, file: IO[bytes]) -> tuple[list[ManifestEntry], list[str]]:
    entries, damaged, check = list[ManifestEntry](), list[str](), ""
    for number in itertools.count(1):
        line = file.readline(MAX_LINE)
        if not line and number > 1:
            break
        parsed = _parse(line, check)
        check = parsed.check
        if not parsed.intact or (number == 1) != (parsed.entry is None):
            damaged.append(f"{path}: line {number} or the line before it is damaged; {ADVICE}")
        elif parsed.entry:
            entries.append(parsed.entry)
        if len(damaged) == MAX_DAMAGED_LINES:
            damaged.append(f"{path}: more than {MAX_DAMAGED_LINES} damaged lines; {ADVICE}")
            break
    return entries, damaged


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
    """Parse a line, and check that it follows one with the checksum `previous`, if given."""
    try:
        text = line.decode()
        content = json.loads(text)
        check = content.pop("check")
        if not isinstance(check, str):
            return _ParsedLine()
        intact = text.endswith("\n") and (previous is None or _line(content, previous)[0] == text)
        if content == HEADER:
            return _ParsedLine(None, check, intact)
        # Names are not looked up: a task of another package may not be registered here.
        content["env_id"] = split_env_id(content["env_id"])
        entry = convert(content, ManifestEntry, "entry", DatasetError)
        return _ParsedLine(entry, check, intact)
    except (AttributeError, LookupError, MagicalError, RecursionError, TypeError, ValueError):
        return _ParsedLine()


def _write_all(file: Any, data: bytes) -> None:
    while data:
        data = data[file.write(data) :]
