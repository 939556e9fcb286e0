"""Evaluated runs on disk, each in a folder or many together (docs/protocol.md).

An entry is how a policy was evaluated, what it learned from, and its scores: `entry.json` and
`scores.csv` in a folder. A collection is many of them: `entries.json` has the contents of each
`entry.json` by name, `scores.csv.gz` the rows of all `scores.csv`, each preceded by the name. A
hundred runs take a hundredth of the space of their folders.
"""

import csv
import gzip
import io
import json
import os
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Self

from msgspec import Meta

from magical import __version__
from magical.envs.action_spec import DISCRETE
from magical.errors import MagicalError, ScoresError
from magical.evaluation.policy import Policy, action_spec_of, observed
from magical.evaluation.protocol import Evaluated, Evaluation
from magical.evaluation.scores import HEADER, MAX_ROWS, RolloutScore, check_protocol, parse_rows
from magical.files import convert, read_json, reading, write_atomically, write_json
from magical.messages import quoted
from magical.observe import STATE, Observation, parse_spec
from magical.runs import parse_source, provenance
from magical.tasks import parse_horizon
from magical.tasks.horizons import APPENDIX

SCORES_FILE, ENTRY_FILE = "scores.csv", "entry.json"
ROWS_FILE, ENTRIES_FILE = "scores.csv.gz", "entries.json"
COLLECTION_BYTES = 1 << 26  # of `entries.json`
COLLECTION_ROWS = 1_000_000  # of a compressed file, which may hold any number
MAX_THREADS = 1024  # the most that an entry can ask for

Text = Annotated[str, Meta(max_length=200)]
Count = Annotated[int, Meta(ge=0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """What a policy was made from, and what evaluated it; `None` or empty if not stated."""

    policy: Text = ""  # a run folder relative to the entry, or a policy's name
    learned_from: tuple[Text, ...] | None = None  # terms of `magical.runs.SOURCES`
    demonstrations: Text = ""  # how many and whose
    num_demos: Count | None = None  # of each task
    pretrained_on: tuple[Text, ...] = ()  # tasks
    algorithm: Text = ""
    preset: Text = ""
    training_seed: int | None = None
    updates: tuple[Count, Count] | None = None  # of training: done, planned
    test_evaluations: Count | None = None  # of test variants, while the method was designed
    threads: Annotated[int, Meta(ge=1, le=MAX_THREADS)] | None = None  # of the acting network
    date: Text = ""  # when the evaluation began, ISO 8601
    versions: dict[Text, Text] = field(default_factory=dict)
    commit: Text | None = None
    machine: dict[Text, Text] = field(default_factory=dict)
    notes: Annotated[str, Meta(max_length=2000)] = ""  # authors, links

    def __post_init__(self) -> None:
        for name in self.learned_from or ():
            parse_source(name)

    @property
    def unfinished(self) -> str:
        """How far training was, such as `25 of 600 updates`; empty if finished or not stated."""
        done, planned = self.updates or (0, 0)
        return f"{done} of {planned} updates" if done < planned else ""


def record_of(policy: Policy, name: str, out: Path) -> Record:
    """What an entry in the folder `out` records about a policy and its evaluation now.

    `name` is a run folder, which is recorded relative to `out`, or another policy's name.
    """
    if Path(name).is_dir():  # `..` of a link is elsewhere
        name = os.path.relpath(Path(name).resolve(), out.resolve())
    made = {"policy": name, "date": f"{datetime.now(UTC):%FT%TZ}", **provenance()}
    if updates := getattr(policy, "updates", None):
        made["updates"] = list(updates)
    stated = dict(getattr(policy, "record", None) or {})
    return convert({**stated, **made}, Record, "the policy's record", ScoresError)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One training run's evaluation: how it was done, what was learned from, every score."""

    method: str  # its name in tables
    evaluated: Evaluated
    record: Record = field(default_factory=Record)
    scores: Sequence[RolloutScore] = field(default=(), repr=False)
    version: str = __version__  # of this package

    def __post_init__(self) -> None:
        stated = (("method", self.method), ("observation", self.evaluated.observation))
        for name, text in (*stated, ("version", self.version)):
            if not str(text).isprintable():
                raise ScoresError(f"{name}: expected printable characters, found {quoted(text)}")
        if not self.method.strip():
            raise ScoresError(f"method: expected a name, found {self.method!r}")

    @classmethod
    def of(
        cls, policy: Policy, evaluation: Evaluation, *, method: str, record: Record, **others: Any
    ) -> Self:
        """The entry for an evaluation; raises `ScoresError` for one with too many rollouts."""
        if (count := len(evaluation.env_ids) * evaluation.rollouts) > MAX_ROWS:
            raise ScoresError(f"expected at most {MAX_ROWS} rollouts in an entry, found {count}")
        task = evaluation.env_ids[0].task_spec
        observation, privileged = observed(policy, evaluation.observation, task)
        shown = {"observation": observation, "privileged": privileged}
        shown["action_space"] = action_spec_of(policy).name
        evaluated = Evaluated(env_ids=evaluation.env_ids, **(evaluation.settings | shown))
        return cls(method=method, evaluated=evaluated, record=record, **others)

    @property
    def observation(self) -> str:
        """What the policy was shown, as text."""
        return str(self.evaluated.observation or "")

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that the policy was evaluated on."""
        return tuple(dict.fromkeys(env_id.task for env_id in self.evaluated.env_ids))

    def evaluation(self, policy: Policy) -> Evaluation:
        """The evaluation to repeat with the entry's policy."""
        observation: Observation = None
        # The recorded observation is used only if the policy does not state its own.
        if getattr(policy, "observation", None) is None:
            with suppress(MagicalError):  # not an observation that is known here
                spec = parse_spec(self.observation, self.evaluated.env_ids[0].task_spec)
                observation = spec if self.observation.startswith("{") else self.observation
        return replace(self.evaluated, observation=observation)

    def write(self, folder: Path | str) -> None:
        """Write both files.

        Notes of an earlier entry there of the same method and policy are kept, and the larger
        number of test evaluations.
        """
        target, entry = Path(folder) / ENTRY_FILE, self
        with suppress(MagicalError):
            old = convert(_renamed(read_json(target, dict, ScoresError)), _File, "", ScoresError)
            if (old.method, old.record.policy) == (self.method, self.record.policy):
                numbers = (old.record.test_evaluations, self.record.test_evaluations)
                most = max((n for n in numbers if n is not None), default=None)
                notes = self.record.notes or old.record.notes
                entry = replace(
                    self, record=replace(self.record, test_evaluations=most, notes=notes)
                )
        with write_atomically(target) as file:
            file.write((json.dumps(entry.stated, indent=2) + "\n").encode())
            file.flush()
            # Within, so that without space on the disk both files stay as they were.
            write_scores(self.scores, Path(folder) / SCORES_FILE)

    @property
    def stated(self) -> dict[str, Any]:
        """Everything except the scores as plain data: what `entry.json` holds."""
        how = self.evaluated
        stated = _File(
            method=self.method,
            observation=self.observation,
            privileged=how.privileged,
            action_space=how.action_space,
            horizon=how.horizon_name,
            nudge=how.nudge,
            seed=how.seed,
            version=self.version,
        )
        default = asdict(Record())
        kept = {n: value for n, value in asdict(self.record).items() if value != default[n]}
        return {**asdict(stated), "record": kept}


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """What `entry.json` holds."""

    method: Text
    observation: Text = ""
    privileged: bool = False
    action_space: Text = DISCRETE.name
    horizon: Text = APPENDIX
    nudge: float = 0.0
    seed: Count = 0
    version: Text = ""
    record: Record = field(default_factory=Record)


def _renamed(data: dict[str, Any]) -> dict[str, Any]:
    """The contents of an `entry.json` with the names that earlier versions wrote replaced."""
    details = data.get("details")
    if not isinstance(details, dict) or "record" in data:
        return data
    kept, record = {**data}, {**details}
    del kept["details"]
    if "looks" in record:
        record["test_evaluations"] = record.pop("looks")
    if "action_space" in record:
        kept["action_space"] = record.pop("action_space")
    return {**kept, "record": record}


def make_entry(data: dict[str, Any], scores: Sequence[RolloutScore], stated_in: str) -> Entry:
    """An entry from the contents of `entry.json`; raises `ScoresError` saying what is wrong."""
    file = convert(_renamed(data), _File, stated_in, ScoresError)
    try:
        check_protocol(scores, file.seed)
        evaluated = Evaluated(
            env_ids=tuple(dict.fromkeys(row.env_id for row in scores)),
            rollouts=1 + max(row.rollout for row in scores),
            seed=file.seed,
            observation=file.observation,
            horizon=parse_horizon(file.horizon),
            nudge=file.nudge,
            action_space=file.action_space,
            privileged=file.privileged or file.observation == STATE,
        )
        return Entry(
            method=file.method,
            evaluated=evaluated,
            record=file.record,
            scores=scores,
            version=file.version,
        )
    except (MagicalError, ValueError) as error:
        raise ScoresError(f"{stated_in}: {error}") from error


def read_entry(folder: Path | str) -> Entry:
    """Read what `Entry.write` wrote; raises `ScoresError` if it breaks format or protocol."""
    source = Path(folder)
    for name in (SCORES_FILE, ENTRY_FILE):
        if not (source / name).exists():
            raise ScoresError(
                f"{source}: expected a folder with {SCORES_FILE} and {ENTRY_FILE}, found no "
                f"{name}; `magical evaluate POLICY --out {source}` writes them"
            )
    data = read_json(source / ENTRY_FILE, dict[str, Any], ScoresError)
    return make_entry(data, read_scores(source / SCORES_FILE), str(source / ENTRY_FILE))


def write_scores(scores: Iterable[RolloutScore], path: Path | str) -> None:
    """Write `scores.csv`; floats are read back unchanged."""
    with write_atomically(path) as file, io.TextIOWrapper(file, "utf-8", newline="") as text:
        _write_rows(text, HEADER, scores)


def _write_rows(text: io.TextIOBase, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)


def read_scores(path: Path | str) -> list[RolloutScore]:
    """Read what `write_scores` wrote; raises `ScoresError` naming the line that is wrong."""
    with (
        reading(path, ScoresError),
        Path(path).open(encoding="utf-8", errors="replace", newline="") as text,
    ):
        return [row for _, row in parse_rows(text, HEADER, path, MAX_ROWS)]


def write_collection(folder: Path, entries: Mapping[str, Entry]) -> None:
    """Write the entries by name; the same entries give the same bytes."""
    named = sorted(entries.items())
    with (
        write_atomically(folder / ROWS_FILE) as file,
        gzip.GzipFile("", "wb", fileobj=file, mtime=0) as packed,
        io.TextIOWrapper(packed, "utf-8", newline="") as text,
    ):
        rows = ((name, *row) for name, entry in named for row in entry.scores)
        _write_rows(text, ("entry", *HEADER), rows)
    write_json(folder / ENTRIES_FILE, {name: entry.stated for name, entry in named}, indent=1)


def read_collection(folder: Path) -> dict[str, Entry | ScoresError]:
    """Read every entry by name; for a damaged one the value is its error.

    Raises `ScoresError` if a file is missing or damaged.
    """
    stated = read_json(
        folder / ENTRIES_FILE, dict[str, dict[str, Any]], ScoresError, max_bytes=COLLECTION_BYTES
    )
    path, scores = folder / ROWS_FILE, dict[str, list[RolloutScore]]()
    try:
        with gzip.open(path, "rt", encoding="utf-8", errors="replace", newline="") as text:
            for (name,), row in parse_rows(text, ("entry", *HEADER), path, COLLECTION_ROWS):
                scores.setdefault(name, []).append(row)
    except (OSError, EOFError, zlib.error) as error:
        raise ScoresError(f"{path}: expected compressed scores: {error}") from error
    entries: dict[str, Entry | ScoresError] = {}
    for name, data in stated.items():
        try:
            entries[name] = make_entry(
                data, scores.get(name, []), f"{folder / ENTRIES_FILE}: {name}"
            )
        except ScoresError as error:
            entries[name] = error
    return entries
