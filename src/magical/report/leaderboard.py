"""A leaderboard of evaluated entries as static pages: checks, ranks, pages (docs/protocol.md)."""

import shutil
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from magical import __version__
from magical.errors import MagicalError, RunFolderError, ScoresError, UnknownNameError
from magical.evaluation import Entry, published_tasks
from magical.evaluation.policy import NO_OBSERVATION
from magical.evaluation.protocol import NUDGE, ROLLOUTS, SEED
from magical.evaluation.statistics import ROUNDING, Interval
from magical.grouping import group_by
from magical.observe import parse_spec
from magical.report import table
from magical.report.found import Found, Result, same_run, search_results
from magical.runs import BENCHMARK_PRIOR, EXTRA_DATA, SOURCES, TRACKS, file_name, track_of
from magical.tasks import TASKS, get_task, suites
from magical.tasks.axes import DEMO, TEST_ALL, short_variant
from magical.tasks.task import APPENDIX

ALL_TASKS, HELD_OUT_TASKS = "All tasks", "Held-out tasks"
WITH_PRIOR = ", with a benchmark prior"  # suffix of a board's name
DEMOS = 10  # demonstrations of a task on a suite's board, if a method states a number
STATE = "state"  # listed with an entry's sources if its policy is privileged
MIN_RUNS = 3  # of a method that learned something, on every task, for a rank
NOT_STATED = "expected learned_from in the record; `evaluate --learned-from` states it"
METHODS = "methods"  # folder of the site
MARK = b"<h1>MAGICAL leaderboard</h1>"  # in the index page


class Rejected(NamedTuple):
    """An entry that is not ranked, and why."""

    folder: str
    method: str
    reasons: Sequence[str]


def by_reasons(rejected: Iterable[Rejected]) -> list[tuple[str, list[Rejected]]]:
    """The entries grouped by reasons, largest group first."""
    groups = group_by(rejected, lambda entry: "; ".join(entry.reasons))
    return sorted(groups.items(), key=lambda group: -len(group[1]))


def check_entries(found: Found) -> tuple[list[Result], list[Rejected]]:
    """The entries that can be ranked, and the others with the reasons why not."""
    rejected = [Rejected(str(item.folder), "", [item.reason]) for item in found.skipped]
    accepted: list[Result] = []
    conflicts: list[Rejected] = []
    for result in found.results:
        folder, method = str(result.folder), result.entry.method
        runs = [run for run in accepted if run.entry.method == method]
        reasons = faults(result.entry)
        trained, stated = result.config.get("observation"), result.entry.observation
        if trained not in (None, stated):
            shown = stated or "(not stated)"
            reasons.append(f"observation {shown}, but its run was trained on {trained}")
        if reasons:
            rejected.append(Rejected(folder, method, reasons))
        elif other := same_run(result, runs):
            reason = (
                f"the same run as {other.folder}, judging by its scores or its training_seed: each "
                "run counts only once"
            )
            conflicts.append(Rejected(folder, method, [reason]))
        # All accepted runs of a method agree, so the first one is enough.
        elif runs and (reason := mismatch(result.entry, runs[0])):
            conflicts.append(Rejected(folder, method, [reason]))
        else:
            accepted.append(result)
    return accepted, rejected + conflicts


def faults(entry: Entry) -> list[str]:
    """How a single entry violates the protocol; empty if it does not."""
    how, reasons = entry.evaluated, []
    if how.horizon_name != APPENDIX:
        reasons.append(
            f"horizon {how.horizon_name}, expected {APPENDIX}: evaluate without --horizon"
        )
    if how.nudge != NUDGE:
        reasons.append(f"nudge {how.nudge:g}, expected {NUDGE:g}: evaluate with --noise {NUDGE:g}")
    if not how.privileged and entry.observation != NO_OBSERVATION:
        expected = "expected privileged to be true"
        try:
            if parse_spec(entry.observation, how.env_ids[0].task_spec).num_images == 0:
                reasons.append(f"{entry.observation} has no images: {expected}")
        except MagicalError as error:
            reasons.append(f"{error}; only images are not privileged: {expected}")
    reasons += incompleteness(entry)
    return reasons + ([NOT_STATED] if entry.record.learned_from is None else [])


def incompleteness(entry: Entry) -> Iterator[str]:
    """Why an entry is not a complete evaluation by this version of the package."""
    how = entry.evaluated
    if how.seed != SEED:
        yield f"set {how.seed} of fixed seeds, expected {SEED}: evaluate without --seed"
    if how.rollouts != ROLLOUTS:
        yield f"{how.rollouts} rollouts of each environment, expected {ROLLOUTS}"
    for task, ids in how.by_task.items():
        found = {env_id.variant for env_id in ids}
        if absent := [short_variant(v) for v in get_task(task).variants if v not in found]:
            yield f"{task} without {', '.join(absent)}: all variants of a task are needed"
    if done := entry.record.unfinished:
        yield f"its training run is unfinished ({done}): train it to its end and evaluate again"
    # Nothing that scores depend on changed between 0.1 and 1.0.
    series = "1" if entry.version.startswith("0.1.") else entry.version.partition(".")[0]
    if series != __version__.partition(".")[0]:
        yield (
            f"made by version {entry.version or '(not stated)'} of this package, this is "
            f"{__version__}: scores may differ; evaluate again"
        )


def mismatch(entry: Entry, other: Result) -> str:
    """How an entry's observation or sources differ from a run of its method; empty if equal."""
    first = other.entry
    for what, value, expected in (
        ("observation", entry.observation, first.observation),
        ("privileged", entry.evaluated.privileged, first.evaluated.privileged),
        ("action space", entry.evaluated.action_space, first.evaluated.action_space),
        ("learned from", _sources(entry), _sources(first)),
    ):
        if value != expected:
            return f"{what}: {value}, but {other.folder} of the same method has {expected}"
    return ""


def _sources(entry: Entry) -> str:
    stated = entry.record.learned_from is not None
    return ", ".join(_used(entry)) or ("nothing" if stated else "sources that are not stated")


def _used(entry: Entry) -> tuple[str, ...]:
    return tuple(name for name in SOURCES if name in (entry.record.learned_from or ()))


@dataclass(frozen=True, slots=True)
class Standing:
    """A method's place on a board."""

    method: str
    label: str  # the method, marked if its policy is privileged
    unit: str  # what the intervals are over
    test_all: Interval  # mean score
    demo: Interval
    gap: Interval  # Demo's mean minus TestAll's
    runs_apart: str  # the runs' means on TestAll where a few of them differ much
    used: tuple[str, ...]  # sources of learning, and `STATE`
    statements: table.Statements
    runs: int  # the fewest on any of the board's tasks
    rank: int = 0  # by TestAll, 1 for the highest; the same for equal scores
    gap_rank: int = 0  # by the gap, 1 for the lowest

    @property
    def track(self) -> str:
        """`P`, `R`, `X`, `B` or empty."""
        return track_of(self.used)

    @property
    def is_reference(self) -> bool:
        """Whether it learned nothing and sees the true state, like the scripted experts."""
        return self.used == (STATE,)

    @property
    def is_ranked(self) -> bool:
        """Whether it has enough runs; what learned nothing has no training to repeat."""
        return not self.is_reference and (not self.used or self.runs >= MIN_RUNS)

    @property
    def place(self) -> str:
        """The rank, or why there is none, as text."""
        if self.is_reference:
            return "reference"
        return str(self.rank) if self.is_ranked else f"not ranked: fewer than {MIN_RUNS} runs"

    @property
    def gap_place(self) -> str:
        """The rank by the gap as text; a dash if there is none."""
        return str(self.gap_rank) if self.is_ranked else "–"


class Board(NamedTuple):
    """The standings on the tasks of a suite, or on one task, by TestAll."""

    name: str
    standings: Sequence[Standing]


def make_boards(results: Sequence[Result]) -> list[Board]:
    """The boards of all tasks, of the held-out tasks, and of each task in `TASKS`.

    A board ranks the methods that have all of its tasks. Each board is followed by one for methods
    with a benchmark prior. Empty boards are left out, except the first.
    """
    methods = group_by((result.entry for result in results), attrgetter("method")).values()
    suites_of = {ALL_TASKS: published_tasks(), HELD_OUT_TASKS: suites().get(HELD_OUT_TASKS, ())}
    boards = []
    for name, tasks in {**suites_of, **{task: (task,) for task in TASKS}}.items():
        found = []
        for entries in methods:
            runs = [run for run in entries if not set(tasks).isdisjoint(run.tasks)]
            # The held-out board is of ten demonstrations of each task alone, as far as stated.
            if name != HELD_OUT_TASKS or not any(map(_learned_from_more, runs)):
                found += _standing(runs, tasks)
        prior = [row for row in found if BENCHMARK_PRIOR in row.used]
        boards.append(Board(name, _ranked([row for row in found if row not in prior])))
        boards.append(Board(name + WITH_PRIOR, _ranked(prior)))
    return [board for board in boards if board.standings or board is boards[0]]


def _learned_from_more(run: Entry) -> bool:
    record = run.record
    more = record.pretrained_on or EXTRA_DATA in _used(run)
    return bool(more) or record.num_demos not in (DEMOS, None)


def _standing(entries: Sequence[Entry], tasks: Collection[str]) -> list[Standing]:
    """A method's standing on these tasks, not ranked yet; empty if it lacks any of them."""
    runs = [replace(e, evaluated=replace(e.evaluated, nudge=0.0)) for e in entries]
    methods = table.compared_methods(table.rows_of(runs))
    env_ids = [env_id for env_id in methods[0].env_ids if env_id.task in tasks] if methods else []
    if not env_ids or not {env_id.task for env_id in env_ids} >= set(tasks):
        return []
    (method,) = methods
    method = method.on(env_ids)
    demo, test_all = (
        method.on([env_id for env_id in env_ids if env_id.variant == variant])
        for variant in (DEMO, TEST_ALL)
    )
    gap = method.gap()
    assert gap is not None  # entries with all variants have Demo and TestAll
    return [
        Standing(
            method=runs[0].method,
            label=table.with_conditions(runs[0].method, runs),
            unit=method.unit,
            test_all=test_all.mean(),
            demo=demo.mean(),
            gap=gap,
            runs_apart=test_all.apart(),
            # The same in all runs.
            used=_used(runs[0]) + (STATE,) * runs[0].evaluated.privileged,
            statements=table.gather_statements(runs),
            runs=method.fewest_runs,
        )
    ]


def _ranked(standings: Sequence[Standing]) -> list[Standing]:
    """The standings with their ranks, sorted by TestAll, then by the gap, then by name.

    References get the rank that they would have, but do not affect the ranks of others. Nor do
    methods of too few runs, which come last.
    """
    ranked = [row for row in standings if row.is_ranked]
    few = [row for row in standings if not (row.is_ranked or row.is_reference)]
    placed = []
    for row in standings:
        others = few if row in few else ranked
        better = [o for o in others if o.test_all.value > row.test_all.value + ROUNDING]
        closer = [o for o in others if o.gap.value < row.gap.value - ROUNDING]
        placed.append(replace(row, rank=1 + len(better), gap_rank=1 + len(closer)))

    def order(row: Standing) -> tuple[Any, ...]:
        is_few = not (row.is_ranked or row.is_reference)
        return is_few, row.rank, not row.is_reference, row.gap_rank, row.method

    return sorted(placed, key=order)


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """The ranked methods, and the entries that are not ranked."""

    boards: Sequence[Board]
    accepted: Sequence[Result]
    rejected: Sequence[Rejected]
    rerun: frozenset[str] = frozenset()  # methods whose rollouts were run again

    def write(self, site: Path) -> None:
        """Write the index, and a report of each method; those of an earlier one are removed.

        Raises:
            RunFolderError: the index page or `methods` exists but is not a leaderboard's.
        """
        index, folder = site / "index.html", site / METHODS
        ours = index.exists() and MARK in index.read_bytes()
        if not ours and (index.exists() or folder.exists()):
            raise RunFolderError(
                f"{site}: expected no pages or a leaderboard's; choose another folder"
            )
        shutil.rmtree(folder, ignore_errors=True)
        pages = {}
        groups = group_by(self.accepted, attrgetter("entry.method"))
        for number, (method, results) in enumerate(groups.items(), 1):
            pages[method] = f"{METHODS}/{number:03d}-{file_name(method)}.html"
            published = table.matching_methods(result.entry for result in results)
            table.write_page(site / pages[method], method, Found(results), published)
        used = {name for board in self.boards for row in board.standings for name in row.used}
        filters = {**SOURCES, STATE: "the true state instead of an observation"}
        html = table.render_template(
            "leaderboard.html.j2",
            board=self,
            interval_text=table.interval_text,
            unranked=by_reasons(self.rejected),
            tracks={name: SOURCES[source] for name, source in TRACKS.items()},
            pages=pages,
            filters={name: text for name, text in filters.items() if name in used},
            rollouts=ROLLOUTS,
            nudge=f"{NUDGE:g}",
            version=__version__,
        )
        table.write_text(index, html)


def make_leaderboard(folders: Iterable[Path | str], rerun: Iterable[str] = ()) -> Leaderboard:
    """Check and rank all entries in or below the folders.

    The methods in `rerun` are marked: their rollouts were run again.

    Raises:
        ScoresError: a folder is missing.
        UnknownNameError: a method to mark is not ranked.
    """
    places = list(map(Path, folders))
    for place in places:
        if not place.is_dir():
            raise ScoresError(f"{place}: expected a folder with entries, found none")
    accepted, rejected = check_entries(search_results(places))
    methods = {result.entry.method for result in accepted}
    if unknown := sorted(set(rerun) - methods):
        raise UnknownNameError(f"expected ranked methods to mark as rerun, found {unknown}")
    return Leaderboard(make_boards(accepted), accepted, rejected, frozenset(rerun))
