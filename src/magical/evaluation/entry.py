"""An evaluated run on disk: `scores.csv` and `entry.json` (docs/protocol.md)."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from magical.errors import ScoresError
from magical.evaluation.scores import RolloutScore, check_protocol, read_scores, write_scores
from magical.files import write_atomically
from magical.scene.constants import MAX_NUDGE
from magical.tasks import Horizon
from magical.untrusted import check_plain

APPENDIX, PUBLISHED = "appendix", "published"  # horizons
POLICY = "policy"  # in the details: a run folder relative to the entry's, or a policy's name
THREADS = "threads"  # in the details: CPU threads of a network that acted
SCORES_FILE, ENTRY_FILE = "scores.csv", "entry.json"


@dataclass(frozen=True, slots=True)
class Entry:
    """One training run's evaluation: how it was made, and every rollout's score.

    Entries with the same `row` are runs of one method and share a row of the tables.
    """

    method: str
    scores: Sequence[RolloutScore] = field(repr=False)
    observation: str = ""  # the policy's observation; "state" for a privileged one
    privileged: bool = False
    horizon: str = APPENDIX  # or PUBLISHED, or a number of control steps
    nudge: float = 0.0  # the largest shift of initial poses, in units and radians
    seed: int = 0  # which set of fixed seeds
    version: str = ""  # of this package
    details: dict[str, Any] = field(default_factory=dict)  # demonstrations, training, authors, ...

    @property
    def row(self) -> str:
        """The row's label: the method, and the nudge if there was one."""
        return f"{self.method}, nudge {self.nudge:g}" if self.nudge else self.method

    @property
    def steps(self) -> Horizon:
        """The horizon as `magical.evaluation.evaluate` takes it."""
        if self.horizon == APPENDIX:
            return None
        return "published" if self.horizon == PUBLISHED else int(self.horizon)

    def write(self, folder: Path | str) -> None:
        """Write both files.

        Of an entry of the same method and policy that the folder already holds, the details that
        this one lacks are kept. Raises what `check_writable` raises, before anything is written.
        """
        text = self._json(Path(folder) / ENTRY_FILE)
        write_scores(self.scores, Path(folder) / SCORES_FILE)
        with write_atomically(Path(folder) / ENTRY_FILE) as file:
            file.write(text.encode())

    def check_writable(self, folder: Path | str) -> None:
        """Check, before scores are computed, that `write` will not be refused.

        Raises:
            ScoresError: a field that `read_entry` would refuse, or a damaged entry in the folder.
            TypeError: details that are not JSON.
        """
        self._json(Path(folder) / ENTRY_FILE)

    def _kept(self, target: Path) -> dict[str, Any]:
        """The details of an earlier entry of the same method and policy."""
        old = _read_json(target) if target.exists() else {}
        details = old.get("details")
        if not isinstance(details, dict) or old.get("method") != self.method:
            return {}
        policies = {str(d[POLICY]) for d in (details, self.details) if POLICY in d}
        return details if len(policies) < 2 else {}

    @property
    def stated(self) -> dict[str, Any]:
        """All but the scores, as plain data: what `entry.json` holds."""
        names = (field.name for field in fields(self) if field.name != "scores")
        return {name: getattr(self, name) for name in names}

    def _json(self, target: Path) -> str:
        data = {**self.stated, "details": self._kept(target) | self.details}
        text = json.dumps(data, indent=2) + "\n"
        _check_fields(target, _parse(target, text))
        return text


def read_entry(folder: Path | str) -> Entry:
    """Read what `Entry.write` wrote, and check it against the protocol.

    Raises:
        ScoresError: a file is missing or damaged, or the rollouts are not the protocol's; says
            which and what was expected.
    """
    source = Path(folder)
    for name in (SCORES_FILE, ENTRY_FILE):
        if not (source / name).is_file():
            raise ScoresError(
                f"{source}: expected {SCORES_FILE} and {ENTRY_FILE}, found no {name}; "
                f"`magical evaluate POLICY --out {source}` writes them"
            )
    data = _read_json(source / ENTRY_FILE)
    scores = read_scores(source / SCORES_FILE)
    return make_entry(data, scores, str(source / ENTRY_FILE), str(source / SCORES_FILE))


def make_entry(
    data: dict[str, Any], scores: Sequence[RolloutScore], stated_in: str, scored_in: str
) -> Entry:
    """An entry of what `entry.json` holds; raises `ScoresError` with the name of what is wrong."""
    known = {field.name for field in fields(Entry)} - {"scores"}
    if "method" not in data or set(data) - known:
        raise ScoresError(
            f"{stated_in}: expected method and some of {sorted(known)}, found {sorted(data)}; put "
            "everything else into details"
        )
    _check_fields(Path(stated_in), data)
    try:
        check_protocol(scores, data.get("seed", 0))
    except ScoresError as error:
        raise ScoresError(f"{scored_in}: {error}") from error
    return Entry(scores=scores, **data)


_TYPES = {
    "method": (str,),
    "observation": (str,),
    "privileged": (bool,),
    "horizon": (str,),
    "nudge": (float, int),
    "seed": (int,),
    "version": (str,),
    "details": (dict,),
}
MAX_TEXT = 200  # characters of a text field


def _check_fields(path: Path, data: dict[str, Any]) -> None:
    """Raise `ScoresError` for a field of another type or range, or text that cannot be printed."""
    for name, value in data.items():
        expected = _TYPES[name]
        if type(value) not in expected or (isinstance(value, int | float) and not value >= 0):
            raise ScoresError(
                f"{path}: {name}: expected {expected[0].__name__}, found {type(value).__name__}"
            )
        if isinstance(value, str) and (len(value) > MAX_TEXT or not value.isprintable()):
            raise ScoresError(
                f"{path}: {name}: expected at most {MAX_TEXT} printable characters, found "
                f"{value!r:.{MAX_TEXT}}"
            )
    if not data.get("nudge", 0.0) <= MAX_NUDGE:
        raise ScoresError(f"{path}: nudge: expected at most {MAX_NUDGE}, found {data['nudge']}")
    _check_horizon(path, data.get("horizon", APPENDIX))


def _check_horizon(path: Path, horizon: str) -> None:
    if horizon not in (APPENDIX, PUBLISHED) and not re.fullmatch("[1-9][0-9]{0,5}", horizon):
        raise ScoresError(
            f"{path}: horizon: expected {APPENDIX}, {PUBLISHED} or a number of control steps, "
            f"found {horizon!r}"
        )


def _read_json(path: Path) -> dict[str, Any]:
    return _parse(path, path.read_bytes())


def _parse(path: Path, text: str | bytes) -> dict[str, Any]:
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ScoresError(f"{path}: expected JSON, found none: {error}") from error
    if not isinstance(data, dict):
        raise ScoresError(f"{path}: expected a JSON object, found {type(data).__name__}")
    try:
        check_plain(data)
    except ValueError as error:
        raise ScoresError(f"{path}: {error}") from error
    return data
