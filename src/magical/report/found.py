"""Evaluated runs in folders, at any depth, each in its own folder or in a collection."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache, cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from magical.envs import EnvId
from magical.envs.action_spec import DISCRETE
from magical.errors import ResultsError, RunFolderError, ScoresError
from magical.evaluation import BUILT_IN, Entry, RolloutScore, policy_names, read_entry
from magical.evaluation.entry import ENTRIES_FILE, ENTRY_FILE, SCORES_FILE, read_collection
from magical.evaluation.protocol import ROLLOUTS, SEED, Evaluated
from magical.grouping import group_by
from magical.runs import CONFIG, PLAN, REFERENCES, RUNS, Listing, is_run, read_json, read_listing
from magical.tasks.horizons import APPENDIX, PUBLISHED

TELLING = 20  # rollouts whose score is not the most frequent one: enough to identify a run

T = TypeVar("T")


@dataclass(frozen=True)
class Result:
    """An evaluated run, and where it was found."""

    folder: Path
    entry: Entry
    run: Path | None = None  # the folder of the training run, if there is one

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that the run was evaluated on."""
        return self.entry.tasks

    @cached_property
    def config(self) -> dict[str, Any]:
        """The training configuration; empty if there is none or it cannot be read."""
        return {} if self.run is None else _read(self.run / CONFIG)

    @property
    def seed(self) -> int | None:
        """The training seed; `None` if unknown."""
        seed = self.config.get("seed", self.entry.record.training_seed)
        return seed if isinstance(seed, int) else None


class Skipped(NamedTuple):
    """A folder with an entry that is not used."""

    folder: Path
    reason: str


@dataclass(frozen=True, slots=True)
class Found:
    """What was found in and below some folders."""

    results: Sequence[Result]
    skipped: Sequence[Skipped] = ()

    @property
    def entries(self) -> list[Entry]:
        """The entries, in the order of their folders."""
        return [result.entry for result in self.results]


def search_results(folders: Iterable[Path | str]) -> Found:
    """Every entry in or below the folders, in the order of the folders, then by path.

    Symbolic links and folders whose names begin with a dot are not followed. Entries that cannot be
    read, or whose run is no longer in its plan, are listed as skipped. The folder of an entry in a
    collection is the collection's path joined with the entry's name.
    """
    results: list[Result] = []
    skipped: list[Skipped] = []
    known: set[Path] = set()
    listed = cache(_listing)  # every plan is read only once
    for root in map(Path, folders):
        new = [place for place in _places(root) if place.resolve() not in known]
        known.update(place.resolve() for place in new)
        found = [pair for place in new for pair in _entries(place)]
        for place, entry in found or [(root, _read_entry(root))]:  # the error says what is expected
            if place != root and not _is_planned(place, root, listed):
                reason = "not a run of the current plan, but of an earlier one"
                skipped.append(Skipped(place, reason))
            elif isinstance(entry, Entry):
                results.append(Result(place, entry, _run_of(place, entry, root)))
            else:
                skipped.append(Skipped(place, str(entry)))
    return Found(results, skipped)


def find_results(folders: Iterable[Path | str]) -> Found:
    """As `search_results`, but with at least one entry, and each training run once per table row.

    Of several evaluations of a run in the same way (`by_row`), the one with the most scores counts,
    and of these the newest.

    Raises:
        ScoresError: no entry can be read; the message says why the first one cannot.
    """
    found = search_results(folders)
    if not found.results:
        reasons = [item.reason for item in found.skipped]
        raise ScoresError(reasons[0] if reasons else "expected folders, found none")
    skipped = list(found.skipped)
    counted: list[Result] = []
    for row in by_row(found.results, attrgetter("entry")).values():
        kept: list[Result] = []
        for result in sorted(row, key=lambda r: (len(r.entry.scores), _time(r)), reverse=True):
            if other := same_run(result, kept):
                reason = f"the same run as {other.folder}: each run counts only once in a table row"
                skipped.append(Skipped(result.folder, reason))
            else:
                kept.append(result)
        counted += kept
    results = [result for result in found.results if any(result is kept for kept in counted)]
    return replace(found, results=results, skipped=skipped)


def by_row(items: Iterable[T], entry_of: Callable[[T], Entry]) -> dict[str, list[T]]:
    """Group entries, or what has one, into rows of tables, by the rows' labels.

    The entries of a row have the same method and were evaluated in the same way: with equal
    settings and, on a task that several of them have, with the same horizon. They may have other
    tasks and variants than each other: every cell of a table is of one environment.

    A label is the method's name, then the settings in which the rows of this method differ, except
    those of the protocol. Evaluation noise is always named.
    """
    rows: dict[str, list[T]] = {}
    for method, of_method in group_by(items, lambda item: entry_of(item).method).items():
        found = [(item, entry_of(item).evaluated) for item in of_method]
        parts = [
            ({**dict(settings), "horizon": horizon}, [item for item, _ in part])
            for settings, alike in group_by(found, lambda pair: _settings(pair[1])).items()
            for horizon, part in _by_horizon(alike).items()
        ]
        for settings, part in parts:
            label = ", ".join([method, *_differences(settings, [other for other, _ in parts])])
            while label in rows:  # another method has this name
                label += " (2)"
            rows[label] = part
    return rows


def _settings(evaluated: Evaluated) -> tuple[tuple[str, Any], ...]:
    """Everything that scores depend on, except environments and horizon."""
    return tuple((evaluated.settings | {"horizon": None}).items())


def _by_horizon(
    found: Sequence[tuple[T, Evaluated]],
) -> Mapping[str, Sequence[tuple[T, Evaluated]]]:
    """Evaluations by the horizon in words, or all together if no task has several horizons."""
    groups = group_by(found, lambda pair: _horizon(pair[1]))
    known = {step for _, evaluated in found for step in _steps(evaluated).items()}
    if len(dict(known)) < len(known):
        return groups
    return {" and ".join(name for name in groups if name != APPENDIX) or APPENDIX: found}


def _steps(evaluated: Evaluated) -> dict[str, int]:
    """The number of control steps on each task."""
    tasks = {env_id.task: env_id.task_spec for env_id in evaluated.env_ids}
    return {name: task.resolve_horizon(evaluated.horizon) for name, task in tasks.items()}


def _horizon(evaluated: Evaluated) -> str:
    """The horizon in words: the same for the same numbers of steps on the same tasks."""
    steps = set(_steps(evaluated).values())
    same = evaluated.horizon_name == APPENDIX
    return APPENDIX if same else str(steps.pop()) if len(steps) == 1 else PUBLISHED


def _differences(settings: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> list[str]:
    """What distinguishes a row from the others of its method, in words."""
    rollouts, actions = settings["rollouts"], settings["action_space"]
    said = {
        "observation": settings["observation"],
        "privileged": "privileged" if settings["privileged"] else "",
        "action_space": actions if actions != DISCRETE.name else "",
        "horizon": f"horizon {settings['horizon']}" if settings["horizon"] != APPENDIX else "",
        "rollouts": f"{rollouts} rollout{'s' * (rollouts > 1)}" if rollouts != ROLLOUTS else "",
        "seed": f"seed {settings['seed']}" if settings["seed"] != SEED else "",
    }
    differ = [name for name in said if any(other[name] != settings[name] for other in others)]
    words = [said[name] for name in differ if said[name]]
    return [*words, f"nudge {settings['nudge']:g}"] if settings["nudge"] else words


def same_run(result: Result, others: Iterable[Result]) -> Result | None:
    """The first of the other results that evaluates the same training run of a method, if any.

    If all rollouts that two results share have equal scores, and these scores vary enough, they
    are of one run, whatever the seeds. Otherwise what is known of the training decides: runs that
    fail alike are not one run.
    """
    own = {(row.env_id, row.rollout): row for row in result.entry.scores}
    for other in others:
        same = result.entry.method == other.entry.method and set(result.tasks) & set(other.tasks)
        alike = same and _equal_and_telling(own, other.entry.scores)
        if same and (alike or _same_training(result, other)):
            return other
    return None


def _equal_and_telling(
    own: Mapping[tuple[EnvId, int], RolloutScore], others: Iterable[RolloutScore]
) -> bool:
    """Whether the rollouts that both have score alike, and vary enough to identify a run.

    Good policies score 1 nearly everywhere. Different runs differ within the first few rollouts.
    """
    counts: Counter[float] = Counter()
    for row in others:
        if (mine := own.get((row.env_id, row.rollout))) is not None:
            if mine != row:
                return False
            counts[row.score] += 1
    return counts.total() - max(counts.values(), default=0) >= TELLING


def _same_training(result: Result, other: Result) -> bool:
    """Whether two results of a method are of one run, judging by all but their scores.

    They are if they have the same run folder or training seed, unless what both state of settings,
    demonstrations or policies differs.
    """
    if result.folder == other.folder:  # in a collection, and beside it
        return True
    seeds = result.seed, other.seed
    if None not in seeds and seeds[0] != seeds[1]:
        return False
    if result.run and other.run and result.run.resolve() == other.run.resolve():
        return True
    if any(
        one and two and one != two for one, two in zip(_made(result), _made(other), strict=True)
    ):
        return False
    return None not in seeds or _named_policy(result) == _named_policy(other) in BUILT_IN


def _made(result: Result) -> tuple[Any, ...]:
    record = result.entry.record
    stated = record.demonstrations, record.num_demos, record.pretrained_on
    return (*stated, result.config, _named_policy(result))


def _named_policy(result: Result) -> str:
    """The policy that an entry states, if it is not a run folder, whose path says nothing."""
    record = result.entry.record
    return "" if record.algorithm or is_run(result.folder / record.policy) else record.policy


def _time(result: Result) -> float:
    """When a result was evaluated: its entry's date, or when the file was written; a POSIX time."""
    with suppress(ValueError, OverflowError, OSError):
        return datetime.fromisoformat(result.entry.record.date).timestamp()
    folders = (result.folder, *result.folder.parents)  # an entry of a collection has no folder
    files = (folder / name for folder in folders for name in (ENTRY_FILE, ENTRIES_FILE))
    return next((file.stat().st_mtime for file in files if file.is_file()), 0.0)


def _places(root: Path) -> Iterator[Path]:
    """A folder, even if missing, and all folders below it, sorted, parents before children."""
    yield root
    for path, names, _ in os.walk(root):
        names[:] = sorted(name for name in names if not name.startswith("."))
        if Path(path) != root:
            yield Path(path)


def _entries(place: Path) -> Iterator[tuple[Path, Entry | Exception]]:
    """Every entry in a folder, or why it cannot be read."""
    if (place / ENTRIES_FILE).exists():
        try:
            for name, entry in read_collection(place).items():
                yield place / name, entry
        except ScoresError as error:
            yield place, error
    if (place / SCORES_FILE).exists() or (place / ENTRY_FILE).exists():
        yield place, _read_entry(place)


def _read_entry(place: Path) -> Entry | Exception:
    try:
        return read_entry(place)
    except (ScoresError, OSError) as error:
        return error


def _run_of(place: Path, entry: Entry, root: Path) -> Path | None:
    """The run folder of an entry: the one that it states, else its own, else one above it."""
    if entry.record.policy in policy_names():
        return None
    above = [folder for folder in (place, *place.parents) if folder.is_relative_to(root)]
    stated = place / entry.record.policy
    return next((folder for folder in (stated, *above) if is_run(folder)), None)


def _is_planned(place: Path, root: Path, listed: Callable[[Path], Listing]) -> bool:
    """Whether a folder is not of a plan's run or reference policy, or the plan still lists it."""
    for folder in (place, *place.parents):
        if folder == root:
            break
        results = folder.parent.parent
        if folder.parent.name == RUNS and (results / PLAN).is_file():
            runs = listed(results).runs
            return not runs or any(folder.name == run.folder for run in runs)
        if folder.parent.name == REFERENCES:
            references = listed(results).references
            return references is None or folder.name in references
    return True


def _listing(results: Path) -> Listing:
    """What a results folder lists; nothing if the file is damaged."""
    with suppress(ResultsError):
        return read_listing(results)
    return Listing()


def _read(path: Path) -> dict[str, Any]:
    """A JSON object; empty if the file is missing or damaged."""
    try:
        return read_json(path)
    except RunFolderError:
        return {}
