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
from typing import Any

from magical.envs import EnvId
from magical.errors import ResultsError, RunFolderError, ScoresError
from magical.evaluation import BUILT_IN, Entry, RolloutScore, by_variant, policy_names, read_entry
from magical.evaluation.collection import ENTRIES_FILE, is_collection, read_collection
from magical.evaluation.entry import (
    DATE,
    ENTRY_FILE,
    POLICY,
    SCORES_FILE,
    TRAINING,
    TRAINING_SEED,
)
from magical.report.found.rows import by_row
from magical.runs import is_run, read_json
from magical.runs.folder import CONFIG
from magical.runs.plan import PLAN, REFERENCES, RESULT, RUNS, ListedRun, Listing, read_listing

TELLING = 20  # rollouts whose score is not the most frequent one: enough to identify a run

Listed = Callable[[Path], Listing]  # of a results folder


@dataclass(frozen=True)
class Result:
    """An evaluated run, and where it was found."""

    folder: Path
    entry: Entry
    run: Path | None = None  # the folder of the training run, if there is one

    @cached_property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that the run was evaluated on."""
        return tuple(by_variant(self.entry.scores))

    @cached_property
    def config(self) -> dict[str, Any]:
        """The training configuration; empty if there is none or it cannot be read."""
        return {} if self.run is None else _read(self.run / CONFIG)

    @property
    def seed(self) -> int | None:
        """The training seed; `None` if unknown."""
        seed = self.config.get("seed", self.entry.details.get(TRAINING_SEED))
        return seed if isinstance(seed, int) else None


@dataclass(frozen=True, slots=True)
class Skipped:
    """A folder with an entry that is not used."""

    folder: Path
    reason: str


@dataclass(frozen=True, slots=True)
class Found:
    """What was found in and below some folders."""

    results: Sequence[Result]
    skipped: Sequence[Skipped] = ()
    not_evaluated: Sequence[Path] = ()  # run folders without an entry
    # The planned runs that have no scores, and why, in words; `None` if there is no plan.
    planned: Sequence[tuple[ListedRun, str]] | None = None

    @property
    def entries(self) -> list[Entry]:
        """The entries, in the order of their folders."""
        return [result.entry for result in self.results]


def same_run(result: Result, others: Iterable[Result]) -> Result | None:
    """The first of the other results that evaluates the same training run of a method, if any.

    If all rollouts that two results share have equal scores, and these scores vary enough, they
    are of one run, whatever the seeds. Otherwise what is known of the training decides: runs that
    fail alike are not one run.
    """
    own = {(row.env_id, row.rollout): row for row in result.entry.scores}
    for other in others:
        shared = set(result.tasks) & set(other.tasks)
        if result.entry.method != other.entry.method or not shared:
            continue
        equal = _equal_scores(own, other.entry.scores)
        if (equal and _is_telling(equal)) or _same_training(result, other):
            return other
    return None


def _same_training(result: Result, other: Result) -> bool:
    """Whether two results of a method are of one run, judging by all but their scores.

    They are if they are of the same run folder, or have the same training seed. Settings,
    demonstrations or policies that differ contradict that; what only one of them states does not.
    """
    if result.folder == other.folder:  # in a collection, and beside it
        return True
    seeds = result.seed, other.seed
    if None not in seeds and seeds[0] != seeds[1]:
        return False
    run = _policy_folder(result)
    if is_run(run) and run == _policy_folder(other):
        return True
    details = result.entry.details, other.entry.details
    stated = [(details[0].get(name), details[1].get(name)) for name in TRAINING]
    stated += [(result.config, other.config), (_named_policy(result), _named_policy(other))]
    if any(one and two and one != two for one, two in stated):
        return False
    return None not in seeds or _named_policy(result) == _named_policy(other) in BUILT_IN


def _named_policy(result: Result) -> str:
    """The policy that an entry states, if it is not a run folder, whose path says nothing."""
    is_folder = "algorithm" in result.entry.details or is_run(_policy_folder(result))
    return "" if is_folder else str(result.entry.details.get(POLICY, ""))


def _equal_scores(
    own: Mapping[tuple[EnvId, int], RolloutScore], others: Iterable[RolloutScore]
) -> list[RolloutScore]:
    """The scores of the rollouts that both have, if all are equal; empty if any differs.

    This is fast: scores of different runs usually differ within the first few rollouts.
    """
    equal = []
    for row in others:
        if (mine := own.get((row.env_id, row.rollout))) is not None:
            if mine != row:
                return []
            equal.append(row)
    return equal


def _is_telling(scores: Iterable[RolloutScore]) -> bool:
    """Whether scores vary enough to identify a run: good policies score 1 nearly everywhere."""
    counts = Counter(row.score for row in scores)
    return counts.total() - max(counts.values()) >= TELLING


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
        if found.planned:
            run, why = found.planned[0]
            reasons += [
                f"none of the {len(found.planned)} planned runs has scores yet ({run}: {why}); "
                "`magical status DIR` names the command that continues the plan"
            ]
        raise ScoresError(reasons[0] if reasons else "expected folders, found none")
    skipped = list(found.skipped)
    counted: set[int] = set()
    for row in by_row(found.results, attrgetter("entry")).values():
        kept: list[Result] = []
        for result in sorted(row, key=lambda r: (len(r.entry.scores), _time(r)), reverse=True):
            if other := same_run(result, kept):
                reason = f"the same run as {other.folder}: each run counts only once in a table row"
                skipped.append(Skipped(result.folder, reason))
            else:
                kept.append(result)
        counted |= set(map(id, kept))
    results = [result for result in found.results if id(result) in counted]
    return replace(found, results=results, skipped=skipped)


def _time(result: Result) -> float:
    """When a result was evaluated: its entry's date, or when the file was written; a POSIX time."""
    with suppress(ValueError, OverflowError, OSError):
        return datetime.fromisoformat(str(result.entry.details.get(DATE))).timestamp()
    folders = (result.folder, *result.folder.parents)  # an entry of a collection has no folder
    files = (folder / name for folder in folders for name in (ENTRY_FILE, ENTRIES_FILE))
    return next((file.stat().st_mtime for file in files if file.is_file()), 0.0)


def search_results(folders: Iterable[Path | str], without: Path | None = None) -> Found:
    """Every entry in or below the folders, in the order of the folders, then by path.

    Symbolic links, folders whose names begin with a dot and the folder `without` are not followed.
    Entries that cannot be read, or whose run is no longer in its plan, are listed as skipped. The
    folder of an entry in a collection is the collection's path joined with the entry's name.
    """
    results: list[Result] = []
    skipped: list[Skipped] = []
    places: list[Path] = []
    known: set[Path] = set()
    listed = cache(_listing)  # every plan is read only once
    for root in map(Path, folders):
        new = [place for place in _places(root, without) if place.resolve() not in known]
        places += new
        known.update(place.resolve() for place in new)
        # A root without any entry is read anyway, unless it has a plan: the error says what was
        # expected.
        alone = [place for place in new if place == root and not (place / PLAN).is_file()]
        found = [*_entries(new)] or [(place, _read_entry(place)) for place in alone]
        for place, entry in found:
            if place != root and not _is_planned(place, root, listed):
                skipped.append(
                    Skipped(place, "not a run of the current plan, but of an earlier one")
                )
            elif isinstance(entry, Entry):
                has_no_run = entry.details.get(POLICY) in policy_names()
                results.append(Result(place, entry, None if has_no_run else _run_of(place, root)))
            else:
                skipped.append(Skipped(place, str(entry)))
    evaluated = {place for result in results for place in (result.run, result.folder)}
    evaluated |= {item.folder for item in skipped}
    named = {_policy_folder(result) for result in results}
    runs = [
        place
        for place in places
        if is_run(place) and place not in evaluated and os.path.realpath(place) not in named
    ]
    return Found(results, skipped, runs, _planned(places, evaluated, listed))


def _entries(places: Iterable[Path]) -> Iterator[tuple[Path, Entry | Exception]]:
    """Every entry in some folders, or why it cannot be read."""
    for place in places:
        if is_collection(place):
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


def _policy_folder(result: Result) -> str:
    """The run folder that an entry states as its policy; it may be any text."""
    stated = str(result.entry.details.get(POLICY, ""))
    return "" if "\0" in stated else os.path.realpath(result.folder / stated)


def _places(root: Path, without: Path | None) -> Iterator[Path]:
    """A folder, even if missing, and all folders below it, sorted, parents before children."""
    yield root
    hidden = None if without is None else without.resolve()
    for path, names, _ in os.walk(root):
        kept = [name for name in names if not name.startswith(".")]
        names[:] = sorted(name for name in kept if (Path(path) / name).resolve() != hidden)
        if Path(path) != root:
            yield Path(path)


def _run_of(place: Path, root: Path) -> Path | None:
    """The run folder of an entry: the entry's own, one above it, or the only one in it."""
    for folder in (place, *place.parents):
        if is_run(folder):
            return folder
        if folder == root:
            break
    inside = [path.parent for path in place.glob(f"*/{CONFIG}") if is_run(path.parent)]
    return inside[0] if len(inside) == 1 else None


def _is_planned(place: Path, root: Path, listed: Listed) -> bool:
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


def _planned(
    places: Iterable[Path], evaluated: Iterable[Path | None], listed: Listed
) -> list[tuple[ListedRun, str]] | None:
    """The runs without scores of all plans in the folders, and why they have none."""
    plans = [place for place in places if (place / PLAN).is_file()]
    if not plans:
        return None
    done = {folder.name for folder in evaluated if folder is not None}
    # A plan's runs may be in several results folders; run folder names contain a digest.
    left = {run.folder: (run, plan) for plan in plans for run in listed(plan).runs}
    return [
        (run, run.damage or _state(plan / RUNS / name))
        for name, (run, plan) in left.items()
        if name not in done
    ]


def _listing(results: Path) -> Listing:
    """What a results folder lists; nothing if the file is damaged."""
    with suppress(ResultsError):
        return read_listing(results)
    return Listing()


def _state(folder: Path) -> str:
    """Why a planned run has no scores."""
    final = _read(folder / RESULT)
    if final.get("state") == "failed":
        return f"failed: {final.get('error', 'unknown error')}"
    return "not finished" if is_run(folder) else "not run"


def _read(path: Path) -> dict[str, Any]:
    """A JSON object; empty if the file is missing or damaged."""
    try:
        return read_json(path)
    except RunFolderError:
        return {}
