"""An evaluated run on disk: `scores.csv` and `entry.json` (docs/protocol.md)."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from magical.errors import ScoresError
from magical.evaluation.scores import RolloutScore, read_scores, write_scores
from magical.files import write_atomically

SCORES_FILE, ENTRY_FILE = "scores.csv", "entry.json"


@dataclass(frozen=True, slots=True)
class Entry:
    """One training run's evaluation: how it was made, and every rollout's score.

    Entries with the same `method` are runs of it and share a row of the tables.
    """

    method: str  # the row's name
    scores: Sequence[RolloutScore] = field(repr=False)
    observation: str = ""  # the policy's observation; "state" for a privileged one
    privileged: bool = False
    horizon: str = "appendix"  # or "published", or a number of control steps
    seed: int = 0  # which set of fixed seeds
    version: str = ""  # of this package
    details: dict[str, Any] = field(default_factory=dict)  # demonstrations, training, authors, ...

    def write(self, folder: Path | str) -> None:
        """Write both files; details that `entry.json` already holds and `self` lacks are kept."""
        target = Path(folder) / ENTRY_FILE
        data = {name: value for name, value in asdict(self).items() if name != "scores"}
        if target.exists():
            data["details"] = _read_json(target).get("details", {}) | self.details
        write_scores(self.scores, Path(folder) / SCORES_FILE)
        with write_atomically(target) as file:
            file.write((json.dumps(data, indent=2) + "\n").encode())


def read_entry(folder: Path | str) -> Entry:
    """Read what `Entry.write` wrote.

    Raises:
        ScoresError: a file is missing or damaged; says which and what was expected.
    """
    source = Path(folder)
    for name in (SCORES_FILE, ENTRY_FILE):
        if not (source / name).is_file():
            raise ScoresError(
                f"{source}: expected {SCORES_FILE} and {ENTRY_FILE}, found no {name}; "
                f"`magical evaluate POLICY --out {source}` writes them"
            )
    data = _read_json(source / ENTRY_FILE)
    known = {field.name for field in fields(Entry)} - {"scores"}
    if "method" not in data or set(data) - known:
        raise ScoresError(
            f"{source / ENTRY_FILE}: expected method and some of {sorted(known)}, "
            f"found {sorted(data)}; put everything else into details"
        )
    return Entry(scores=read_scores(source / SCORES_FILE), **data)


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_bytes())
    except ValueError as error:
        raise ScoresError(f"{path}: expected JSON, found none: {error}") from error
    if not isinstance(data, dict):
        raise ScoresError(f"{path}: expected a JSON object, found {data!r:.60}")
    return data
