"""Evaluated runs in folders at any depth: which of them count, and which share a row of tables."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from magical.envs import EnvId
from magical.envs.action_spec import DISCRETE
from magical.errors import MagicalError, RunFolderError, ScoresError
from magical.evaluation import BUILT_IN, Entry, RolloutScore, policy_names, read_entry
from magical.evaluation.entry import ENTRIES_FILE, ENTRY_FILE, SCORES_FILE, read_collection
from magical.evaluation.protocol import ROLLOUTS, SEED
from magical.grouping import group_by
from magical.runs import CONFIG, PLAN, REFERENCES, RUNS, Listing, is_run, read_json, read_listing
from magical.tasks import get_task
from magical.tasks.task import APPENDIX, PUBLISHED

TELLING = 20  # rollouts whose score is not the most frequent one: enough to identify a run

T = TypeVar("T")


@dataclass(frozen=True)
class Result:
    """An evaluated run, and where it was found."""

    folder: Path
    entry: Entry
    run: Path | None = None  # the folder of the training run, if there is one

    @cached_property
    def config(self) -> dict[str, Any]:
        """The training configuration; empty if there is none or it cannot be read."""
        try:
            return read_json(self.run / CONFIG) if self.run else {}
        except RunFolderError:
            return {}

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
    listed = cache(read_listing)  # every plan is read only once
    for root in map(Path, folders):
        found: list[tuple[Path, Entry | Exception]] = []
        for path, names, _ in os.walk(root):
            names[:] = sorted(name for name in names if not name.startswith("."))
            if (place := Path(path)).resolve() not in known:
                known.add(place.resolve())
                found += _entries(place)
        for place, entry in found or _entries(root, required=True):
            if place != root and not _is_planned(place, root, listed):
                reason = "not a run of the current plan, but of an earlier one"
                skipped.append(Skipped(place, reason))
            elif isinstance(entry, Entry):
                results.append(Result(place, entry, _run_of(place, entry, root)))
            else:
                skipped.append(Skipped(place, str(entry)))
    return Found(results, skipped)


def _entries(place: Path, required: bool = False) -> Iterator[tuple[Path, Entry | Exception]]:
    """Every entry in a folder, or why it cannot be read, or if `required` why there is none."""
    if (place / ENTRIES_FILE).exists():
        try:
            for name, entry in read_collection(place).items():
                yield place / name, entry
        except ScoresError as error:
            yield place, error
    if required or (place / SCORES_FILE).exists() or (place / ENTRY_FILE).exists():
        try:
            yield place, read_entry(place)
        except (ScoresError, OSError) as error:
            yield place, error


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
        results, kind = folder.parent.parent, folder.parent.name
        if folder == root:
            break
        if kind in (RUNS, REFERENCES) and (results / PLAN).is_file():
            with suppress(MagicalError):  # a damaged plan lists nothing
                runs = {run.folder for run in listed(results).runs} or None
                names = runs if kind == RUNS else listed(results).references
                return names is None or folder.name in names
            return True
    return True


def find_results(folders: Iterable[Path | str]) -> Found:
    """As `search_results`, but with at least one entry, and each training run once per table row.

    Of several evaluations of a run in the same way (`by_row`), the one with the most scores counts,
    and of these the newest, by the dates in the entries.

    Raises:
        ScoresError: no entry can be read; the message says why the first one cannot.
    """
    found = search_results(folders)
    if not found.results:
        reasons = [item.reason for item in found.skipped]
        raise ScoresError(reasons[0] if reasons else "expected folders, found none")
    skipped = list(found.skipped)
    counted: set[int] = set()
    for row in by_row(found.results, attrgetter("entry")).values():
        kept: list[Result] = []
        order = sorted(row, key=lambda r: (len(r.entry.scores), r.entry.record.date), reverse=True)
        for result in order:
            if other := same_run(result, kept):
                reason = f"the same run as {other.folder}: each run counts only once in a table row"
                skipped.append(Skipped(result.folder, reason))
            else:
                kept.append(result)
        counted |= set(map(id, kept))
    results = [result for result in found.results if id(result) in counted]
    return replace(found, results=results, skipped=skipped)


def by_row(items: Iterable[T], entry_of: Callable[[T], Entry]) -> dict[str, list[T]]:
    """Group entries, or what has one, into rows of tables, by the rows' labels.

    The entries of a row have the same method and were evaluated in the same way: with equal
    settings and, on a task that several of them have, with the same horizon. They may have other
    tasks and variants than each other: every cell of a table is of one environment.

    A label is the method's name, then the settings in which the rows of this method differ, except
    those of the protocol. Evaluation noise is always named.
    """

    def settings_of(item: T) -> tuple[tuple[str, Any], ...]:
        return tuple((entry_of(item).evaluated.settings | {"horizon": None}).items())

    rows: dict[str, list[T]] = {}
    for method, of_method in group_by(items, lambda item: entry_of(item).method).items():
        parts = [
            (dict(settings) | {"horizon": horizon}, part)
            for settings, alike in group_by(of_method, settings_of).items()
            for horizon, part in _by_horizon(alike, entry_of).items()
        ]
        for settings, part in parts:
            label = ", ".join([method, *_differences(settings, [other for other, _ in parts])])
            while label in rows:  # another method has this name
                label += " (2)"
            rows[label] = part
    return rows


def _by_horizon(items: Sequence[T], entry_of: Callable[[T], Entry]) -> dict[str, list[T]]:
    """Evaluations by the horizon in words, or all together if no task has several horizons."""
    groups: dict[str, list[T]] = {}
    horizons: dict[str, set[int]] = {}  # by task
    for item in items:
        how = entry_of(item).evaluated
        steps = {task: get_task(task).resolve_horizon(how.horizon) for task in how.by_task}
        for task, number in steps.items():
            horizons.setdefault(task, set()).add(number)
        # The same words for the same numbers of control steps on the same tasks.
        words = str(*set(steps.values())) if len(set(steps.values())) == 1 else PUBLISHED
        groups.setdefault(APPENDIX if how.horizon_name == APPENDIX else words, []).append(item)
    if any(len(numbers) > 1 for numbers in horizons.values()):
        return groups
    return {" and ".join(name for name in groups if name != APPENDIX) or APPENDIX: [*items]}


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
    entry = result.entry
    own = {(row.env_id, row.rollout): row for row in entry.scores}
    for other in others:
        same = entry.method == other.entry.method and set(entry.tasks) & set(other.entry.tasks)
        if same and (_equal_and_telling(own, other.entry.scores) or _same_training(result, other)):
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
    if any(a and b and a != b for a, b in zip(_made(result), _made(other), strict=True)):
        return False
    return None not in seeds or _made(result)[-1] == _made(other)[-1] in BUILT_IN


def _made(result: Result) -> tuple[Any, ...]:
    """What an entry states of its making; last the policy, unless it is a run folder."""
    record = result.entry.record
    policy = "" if record.algorithm or is_run(result.folder / record.policy) else record.policy
    return record.demonstrations, record.num_demos, record.pretrained_on, result.config, policy
