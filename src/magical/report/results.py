"""Evaluated runs in folders: find them, and say what is missing among them."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.errors import RunFolderError, ScoresError
from magical.evaluation import Entry, by_variant, read_entry
from magical.evaluation.entry import ENTRY_FILE, SCORES_FILE
from magical.evaluation.variants import short_variant
from magical.runs import is_run, read_json
from magical.runs.folder import CONFIG, RECORD
from magical.tasks import get_task


@dataclass(frozen=True, slots=True)
class Result:
    """An evaluated run and where it was found."""

    folder: Path
    entry: Entry
    run: Path | None = None  # the folder of the training run, where there is one

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that it was evaluated on."""
        return tuple(by_variant(self.entry.scores))

    @property
    def config(self) -> dict[str, Any]:
        """The configuration of training; empty where there is none that can be read."""
        return _read_json(self.run, CONFIG)

    @property
    def record(self) -> dict[str, Any]:
        """The record of training (`run.json`): versions, device, demonstrations."""
        return _read_json(self.run, RECORD)

    @property
    def seed(self) -> int | None:
        """The seed of training, where it is known."""
        seed = self.config.get("seed", self.entry.details.get("training_seed"))
        return seed if isinstance(seed, int) else None


@dataclass(frozen=True, slots=True)
class Skipped:
    """A folder with files of an entry that cannot be used."""

    folder: Path
    reason: str


@dataclass(frozen=True, slots=True)
class Results:
    """What was found below some folders."""

    found: Sequence[Result]
    skipped: Sequence[Skipped] = ()
    not_evaluated: Sequence[Path] = ()  # run folders without an entry

    @property
    def entries(self) -> list[Entry]:
        """The entries, in the order of their folders."""
        return [result.entry for result in self.found]


def find_results(folders: Iterable[Path | str]) -> Results:
    """Every entry in or below the folders, by folder as given, then by path.

    Symbolic links and folders whose names begin with a dot are not followed. What cannot be read is
    skipped, and listed.

    Raises:
        ScoresError: there is no entry that can be read; the reason is the first one's.
    """
    found, skipped, runs = [], [], []
    seen: set[Path] = set()
    for root in map(Path, folders):
        places = [place for place in _places(root) if place.resolve() not in seen]
        seen.update(place.resolve() for place in places)
        runs += [place for place in places if is_run(place)]
        holders = [place for place in places if _holds_entry(place)]
        for place in holders if places and (holders or runs) else [root]:
            try:
                found.append(Result(place, read_entry(place), _run_of(place, root)))
            except (ScoresError, OSError) as error:
                skipped.append(Skipped(place, str(error)))
    if not found:
        reason = skipped[0].reason if skipped else f"expected evaluated runs, found {len(runs)} "
        raise ScoresError(reason if skipped else f"{reason}run folders without {SCORES_FILE}")
    evaluated = {result.run for result in found} | {item.folder for item in skipped}
    return Results(found, skipped, [run for run in runs if run not in evaluated])


@dataclass(frozen=True, slots=True)
class Missing:
    """Scores that other methods or runs have."""

    method: str
    task: str
    what: str


def find_missing(results: Sequence[Result]) -> list[Missing]:
    """Which method x task x variant x run is missing among the results.

    A method is expected to have every task that any method has, with as many runs, with the same
    seeds of training where those are known, on every variant of the task.
    """
    methods = list(dict.fromkeys(result.entry.row for result in results))
    tasks = list(dict.fromkeys(task for result in results for task in result.tasks))
    gaps = []
    for task in tasks:
        runs = {
            name: [r for r in results if r.entry.row == name and task in r.tasks]
            for name in methods
        }
        most = max(map(len, runs.values()))
        seeds = {run.seed for group in runs.values() for run in group} - {None}
        for name, group in runs.items():
            texts = [_missing_runs(group, most, sorted(seed for seed in seeds if seed is not None))]
            texts += [_missing_variants(task, run) for run in group]
            gaps += [Missing(name, task, text) for text in texts if text]
    return gaps


def _missing_runs(group: Sequence[Result], most: int, seeds: Sequence[int]) -> str:
    if not group:
        return "no run"
    if len(group) == most:
        return ""
    present = {run.seed for run in group}
    absent = [str(seed) for seed in seeds if seed not in present]
    named = f": no seed {', '.join(absent)}" if absent and None not in present else ""
    return f"{len(group)} of {most} runs{named}"


def _missing_variants(task: str, run: Result) -> str:
    present = by_variant(run.entry.scores)[task]
    names = [short_variant(name) for name in get_task(task).variants]
    absent = [name for name in names if name not in present]
    which = run.folder.name if run.seed is None else f"seed {run.seed}"
    return f"{which}: not evaluated on {', '.join(absent)}" if absent else ""


def _places(root: Path) -> Iterator[Path]:
    """A folder and all folders below it, parents before children, by name."""
    for path, names, _ in os.walk(root):
        names[:] = sorted(name for name in names if not name.startswith("."))
        yield Path(path)


def _holds_entry(place: Path) -> bool:
    return (place / SCORES_FILE).exists() or (place / ENTRY_FILE).exists()


def _run_of(place: Path, root: Path) -> Path | None:
    """The run folder that an entry belongs to: its own, one above it, or the only one in it."""
    parents = [place, *place.parents] if place != root else [place]
    for folder in parents:
        if is_run(folder):
            return folder
        if folder == root:
            break
    inside = [path for path in sorted(place.iterdir()) if path.is_dir() and is_run(path)]
    return inside[0] if len(inside) == 1 else None


def _read_json(run: Path | None, name: str) -> dict[str, Any]:
    try:
        return {} if run is None else read_json(run / name)
    except RunFolderError:
        return {}
