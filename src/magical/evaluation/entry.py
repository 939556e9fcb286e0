"""Scores and evaluated runs: in memory, and on disk in a folder each or many together.

An entry is how a policy was evaluated, what it learned from, and its scores: `entry.json` and
`scores.csv` in a folder. A collection is many of them: `entries.json` has the contents of each
`entry.json` by name, `scores.csv.gz` the rows of all `scores.csv`, each preceded by the name. A
hundred runs take a hundredth of the space of their folders (docs/protocol.md).
"""

import csv
import gzip
import io
import json
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import lru_cache, partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import IO, Annotated, Any, NamedTuple, Self

import numpy as np
from msgspec import Meta

from magical import __version__
from magical.envs import EnvId, parse_env_id
from magical.envs.action_spec import DISCRETE
from magical.envs.seeds import evaluation_seed
from magical.errors import MagicalError, PolicyError, ScoresError, UnknownNameError
from magical.evaluation.policy import Policy, action_spec_of, load_policy, observed, policy_names
from magical.evaluation.protocol import Evaluated, Evaluation
from magical.files import convert, read_json, reading, write_atomically, write_json
from magical.grouping import group_by
from magical.messages import printable, quoted
from magical.observe import STATE, Observation, parse_spec
from magical.runs import SOURCES, is_run, provenance
from magical.tasks.axes import short_variant
from magical.tasks.task import APPENDIX

SCORES_FILE, ENTRY_FILE = "scores.csv", "entry.json"
ROWS_FILE, ENTRIES_FILE = "scores.csv.gz", "entries.json"
MAX_ROWS = 60_000  # of an entry: 1,000 rollouts in each of sixty environments
MAX_LINE = 2000  # characters
COLLECTION_BYTES = 1 << 26  # of `entries.json`
COLLECTION_ROWS = 1_000_000  # of a compressed file, which may hold any number
MAX_THREADS = 1024  # the most that an entry can ask for

# Without control characters, ends of lines and changes of direction.
_SHOWN = r"[^\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]*\Z"
Text = Annotated[str, Meta(max_length=200, pattern=rf"^{_SHOWN}")]
Count = Annotated[int, Meta(ge=0)]


class RolloutScore(NamedTuple):
    """One rollout and its final state's scores by both rules."""

    env_id: EnvId
    rollout: int
    seed: int
    score: float
    published_code_score: float


HEADER = RolloutScore._fields


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
        if unknown := [name for name in self.learned_from or () if name not in SOURCES]:
            raise UnknownNameError(
                f"{quoted(unknown[0])} is not a source of learning; expected some of: "
                f"{', '.join(SOURCES)}"
            )

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
class _File:
    """What `entry.json` holds."""

    method: Annotated[str, Meta(max_length=200, pattern=rf"^(?=.*\S){_SHOWN}")]
    observation: Text = ""
    privileged: bool = False
    action_space: Text = DISCRETE.name
    horizon: Text = APPENDIX
    nudge: float = 0.0
    seed: Count = 0
    version: Text = ""
    record: Record = field(default_factory=Record)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One training run's evaluation: how it was done, what was learned from, every score."""

    method: str  # its name in tables
    evaluated: Evaluated
    record: Record = field(default_factory=Record)
    scores: Sequence[RolloutScore] = field(default=(), repr=False)
    version: str = __version__  # of this package

    @classmethod
    def of(
        cls, policy: Policy, evaluation: Evaluation, *, method: str, record: Record, **others: Any
    ) -> Self:
        """The entry for an evaluation; raises `ScoresError` for one with too many rollouts."""
        if not method.strip():
            raise ScoresError(f"method: expected a name, found {method!r}")
        if (count := len(evaluation.env_ids) * evaluation.rollouts) > MAX_ROWS:
            raise ScoresError(f"expected at most {MAX_ROWS} rollouts in an entry, found {count}")
        task = evaluation.env_ids[0].task_spec
        observation, privileged = observed(policy, evaluation.observation, task)
        own = {"privileged": privileged, "action_space": action_spec_of(policy).name}
        how = {**evaluation.settings, "observation": observation, **own}
        evaluated = Evaluated(env_ids=evaluation.env_ids, **how)
        return cls(method=method, evaluated=evaluated, record=record, **others)

    @property
    def observation(self) -> str:
        """What the policy was shown, as text."""
        return str(self.evaluated.observation or "")

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that the policy was evaluated on."""
        return tuple(self.evaluated.by_task)

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
        target, record = Path(folder) / ENTRY_FILE, self.record
        with suppress(MagicalError):
            old = convert(_renamed(read_json(target, dict, ScoresError)), _File, "", ScoresError)
            if (old.method, old.record.policy) == (self.method, record.policy):
                numbers = (old.record.test_evaluations, record.test_evaluations)
                most = max((n for n in numbers if n is not None), default=None)
                notes = record.notes or old.record.notes
                record = replace(record, test_evaluations=most, notes=notes)
        with write_atomically(target) as file:
            stated = replace(self, record=record).stated
            file.write((json.dumps(stated, indent=2) + "\n").encode())
            file.flush()
            # Within, so that without space on the disk both files stay as they were.
            write_scores(self.scores, Path(folder) / SCORES_FILE)

    @property
    def stated(self) -> dict[str, Any]:
        """Everything except the scores as plain data: what `entry.json` holds."""
        how, default = self.evaluated, asdict(Record())
        record = {k: value for k, value in asdict(self.record).items() if value != default[k]}
        own = {"method": self.method, "version": self.version, "record": record}
        settings = how.settings | {"observation": self.observation, "horizon": how.horizon_name}
        return {each.name: (settings | own)[each.name] for each in fields(_File)}


def _renamed(data: dict[str, Any]) -> dict[str, Any]:
    """The contents of an `entry.json` with the names that earlier versions wrote replaced."""
    details = data.get("details")
    if not isinstance(details, dict) or "record" in data:
        return data
    record = {"test_evaluations" if n == "looks" else n: value for n, value in details.items()}
    kept = {name: value for name, value in data.items() if name != "details"}
    if "action_space" in record:
        kept["action_space"] = record.pop("action_space")
    return {**kept, "record": record}


def _make_entry(data: dict[str, Any], scores: Sequence[RolloutScore], stated_in: str) -> Entry:
    """An entry from the contents of `entry.json`; raises `ScoresError` saying what is wrong.

    Every environment must have the same rollouts, each once and with the protocol's seed.
    """
    file = convert(_renamed(data), _File, stated_in, ScoresError)
    how = {each.name: getattr(file, each.name) for each in fields(file)}
    others = {name: how.pop(name) for name in ("method", "record", "version")}
    how["privileged"] |= file.observation == STATE
    found = group_by(scores, attrgetter("env_id"))
    count = max(map(len, found.values()), default=0)
    expected = [(number, evaluation_seed(number, file.seed)) for number in range(count)]
    for env_id, rows in found.items():
        if sorted((row.rollout, row.seed) for row in rows) != expected:
            raise ScoresError(
                f"{stated_in}: {env_id}: expected rollouts 0 to {count - 1}, each once, with seeds "
                f"from {expected[0][1]}, as `magical evaluate` makes them, found others"
            )
    try:
        evaluated = Evaluated(env_ids=tuple(found), rollouts=count, **how)
    except (MagicalError, ValueError) as error:
        raise ScoresError(f"{stated_in}: {error}") from error
    return Entry(evaluated=evaluated, scores=scores, **others)


def policy_of(folder: Path, entry: Entry, run: Path | None = None) -> Policy:
    """The policy of an evaluated run: from its run folder, or by a name in `policy_names`.

    Other code that an entry names is not run, since entries may come from anywhere. `run` is the
    run folder if the entry names none. Raises `PolicyError` if it has no such policy.
    """
    name = entry.record.policy
    if name in policy_names():
        return load_policy(name)
    for place in (folder / name, run or folder):
        if is_run(place):
            return load_policy(place)
    raise PolicyError(
        f"{folder}: expected a run folder or one of {', '.join(policy_names())} as the policy "
        f"that was evaluated, found {quoted(name)}; magical verify takes others by --policy"
    )


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
    return _make_entry(data, read_scores(source / SCORES_FILE), str(source / ENTRY_FILE))


def write_scores(scores: Iterable[RolloutScore], path: Path | str) -> None:
    """Write `scores.csv`; floats are read back unchanged."""
    with write_atomically(path) as file:
        _write_rows(file, HEADER, scores)


def read_scores(path: Path | str) -> list[RolloutScore]:
    """Read what `write_scores` wrote; raises `ScoresError` naming the line that is wrong."""
    with (
        reading(path, ScoresError),
        Path(path).open(encoding="utf-8", errors="replace", newline="") as text,
    ):
        return [row for _, row in _parse_rows(text, HEADER, path, MAX_ROWS)]


def write_collection(folder: Path, entries: Mapping[str, Entry]) -> None:
    """Write the entries by name; the same entries give the same bytes."""
    named = sorted(entries.items())
    with (
        write_atomically(folder / ROWS_FILE) as file,
        gzip.GzipFile("", "wb", fileobj=file, mtime=0) as packed,
    ):
        rows = ((name, *row) for name, entry in named for row in entry.scores)
        _write_rows(packed, ("entry", *HEADER), rows)
    write_json(folder / ENTRIES_FILE, {name: entry.stated for name, entry in named}, indent=1)


def read_collection(folder: Path) -> dict[str, Entry | ScoresError]:
    """Read every entry by name; for a damaged one the value is its error.

    Raises `ScoresError` if a file is missing or damaged.
    """
    file, path = folder / ENTRIES_FILE, folder / ROWS_FILE
    kind = dict[str, dict[str, Any]]
    stated = read_json(file, kind, ScoresError, max_bytes=COLLECTION_BYTES)
    scores: dict[str, list[RolloutScore]] = {name: [] for name in stated}
    try:
        with gzip.open(path, "rt", encoding="utf-8", errors="replace", newline="") as text:
            for (name,), row in _parse_rows(text, ("entry", *HEADER), path, COLLECTION_ROWS):
                scores.setdefault(name, []).append(row)
    except (OSError, EOFError, zlib.error) as error:
        raise ScoresError(f"{path}: expected compressed scores: {error}") from error
    entries: dict[str, Entry | ScoresError] = {}
    for name, data in stated.items():
        try:
            entries[name] = _make_entry(data, scores[name], f"{file}: {name}")
        except ScoresError as error:
            entries[name] = error
    return entries


def _write_rows(file: Any, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with io.TextIOWrapper(file, "utf-8", newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _parse_rows(
    text: IO[str], header: Sequence[str], what: object, most: int
) -> Iterator[tuple[list[str], RolloutScore]]:
    """The columns before `HEADER` and the score of each row of a CSV file of any origin.

    Rows are bounded in length, and `most` is their largest number. Raises `ScoresError`, with
    `what` at the beginning, for another header or a row that is not of a rollout.
    """
    # A longer line is read in parts, which are not valid rows.
    lines, where = csv.reader(iter(partial(text.readline, MAX_LINE), "")), str(what)
    try:
        if tuple(found := next(lines, [])) != tuple(header):
            shown = quoted(found) if found else "nothing"
            raise ScoresError(f"expected the header {','.join(header)}, found {shown}")
        for number, line in enumerate(lines, 1):
            where = f"{what}, line {lines.line_num}"
            if number > most:
                raise ScoresError(f"expected at most {most} rows, found more")
            if len(line) != len(header):
                raise ScoresError(f"expected {','.join(header)}, found {quoted(line)}")
            *others, name, rollout, seed, score, published = line
            env_id = _parse_env_id(name)  # may be of a task that is not installed here
            row = RolloutScore(env_id, int(rollout), int(seed), float(score), float(published))
            if not (0.0 <= row.score <= 1.0 and 0.0 <= row.published_code_score <= 1.0):
                raise ScoresError(f"expected scores from 0 to 1, found {quoted(line[-2:])}")
            yield others, row
    except (csv.Error, ValueError) as error:
        raise ScoresError(f"{where}: {printable(str(error), 800)}") from error


@lru_cache(1000)  # parsed once, not in every row
def _parse_env_id(text: str) -> EnvId:
    env_id = parse_env_id(text)
    if env_id.preset is not None:
        raise ScoresError(f"expected an environment id without preset, found {text}")
    return env_id


def by_variant(scores: Iterable[RolloutScore]) -> dict[str, dict[str, list[RolloutScore]]]:
    """Group scores by task, then by the variant's short name, in the order of the rows."""
    table: dict[str, dict[str, list[RolloutScore]]] = {}
    for env_id, rows in groupby(scores, attrgetter("env_id")):  # mostly in order: a few groups
        cells = table.setdefault(env_id.task, {})
        cells.setdefault(short_variant(env_id.variant), []).extend(rows)
    return table


def summarise(scores: Iterable[RolloutScore]) -> dict[str, Any]:
    """Summarise scores as plain data: variant -> `mean`, `std`, `scores`, `published_code_mean`.

    `std` is over rollouts (divisor: their number). Nested by task if there are several.
    """
    table: dict[str, dict[str, Any]] = {}
    for task, cells in by_variant(scores).items():
        for variant, rows in cells.items():
            values = [row.score for row in rows]
            table.setdefault(task, {})[variant] = {
                "mean": float(np.mean(values)),
                "std": float(np.std(values)),
                "scores": values,
                "published_code_mean": float(np.mean([row.published_code_score for row in rows])),
            }
    return next(iter(table.values())) if len(table) == 1 else table
