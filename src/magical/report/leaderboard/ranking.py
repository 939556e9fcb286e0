"""Ranks of methods: by TestAll, and by the generalisation gap."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

from magical.evaluation import published_tasks
from magical.evaluation.intervals import Interval
from magical.evaluation.statistics import ROUNDING
from magical.grouping import group_by
from magical.report.found.search import Result
from magical.report.found.statements import Statements, gather_statements, with_conditions
from magical.report.scores.methods import ComparedMethod, compared_methods
from magical.runs.sources import (
    BENCHMARK_PRIOR,
    EXTRA_DATA,
    NUM_DEMOS,
    PRETRAINED_ON,
    learned_from,
    learning_class,
)
from magical.tasks import TASKS, suites
from magical.tasks.axes import DEMO, TEST_ALL

ALL_TASKS = "All tasks"
HELD_OUT_TASKS, TRAINING_TASKS = "Held-out tasks", "Training tasks"  # suites of magical-goals
WITH_PRIOR = ", with a benchmark prior"  # suffix of a board's name
DEMOS = 10  # demonstrations of a held-out task, without pre-training
FINE_TUNED = (1, 5, 10)  # demonstrations of a held-out task, after pre-training
STATE = "state"  # listed with an entry's sources if its policy is privileged
MIN_RUNS = 3  # of a method that learned something, on every task, for a rank


@dataclass(frozen=True, slots=True)
class Standing:
    """A method's place on a board."""

    method: str
    unit: str  # what the intervals are over
    test_all: Interval  # mean score
    demo: Interval
    gap: Interval  # Demo's mean minus TestAll's
    label: str  # the method, marked if its policy is privileged
    runs_apart: str  # means on TestAll, if a few runs differ much; otherwise empty
    used: tuple[str, ...]  # what it learned from, and `state` for a privileged policy
    statements: Statements
    runs: int  # the fewest on any of the board's tasks
    rank: int = 0  # by TestAll, 1 for the highest; the same for equal scores
    gap_rank: int = 0  # by the gap, 1 for the lowest

    @property
    def learning_class(self) -> str:
        """`P`, `R`, `X`, `B` or empty: see `magical.runs.sources.learning_class`."""
        return learning_class(self.used)

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


@dataclass(frozen=True, slots=True)
class Board:
    """The standings on one task, on all of the paper's tasks, or on the held-out generated tasks.

    Methods with a prior made for the benchmark have separate boards.
    """

    name: str
    standings: Sequence[Standing]  # by TestAll


def make_boards(results: Sequence[Result]) -> list[Board]:
    """The boards of all tasks, of the held-out tasks, and of each task in `TASKS`.

    A board ranks the methods that have all of its tasks. On the held-out tasks, methods that were
    pre-trained on training tasks have a board for each number of demonstrations. Each board is
    followed by one for methods with a benchmark prior. Empty boards are left out, except the first.
    """

    def boards(name: str, tasks: Collection[str], track: str | None = None) -> list[Board]:
        runs = [result for result in results if not set(tasks).isdisjoint(result.tasks)]
        groups = group_by(runs, attrgetter("entry.method"))
        parts = [
            (_on_tasks(_method(group), tasks), group)
            for group in groups.values()
            if track in (None, held_out_board(group))
        ]
        standings = [_standing(method, group) for method, group in parts if method is not None]
        prior = [row for row in standings if BENCHMARK_PRIOR in row.used]
        others = [row for row in standings if row not in prior]
        return [Board(name, _ranked(others)), Board(name + WITH_PRIOR, _ranked(prior))]

    held_out = suites().get(HELD_OUT_TASKS, ())
    tracks = [HELD_OUT_TASKS, *map(pretrained_board, FINE_TUNED)]
    first, *rest = boards(ALL_TASKS, published_tasks())
    for name in tracks:
        rest += boards(name, held_out, track=name)
    for task in TASKS:
        rest += boards(task, [task])
    return [first, *(board for board in rest if board.standings)]


def pretrained_board(num_demos: int) -> str:
    """The name of the board for methods that were pre-trained on training tasks."""
    return f"{HELD_OUT_TASKS}, pre-trained, k = {num_demos}"


def held_out_board(runs: Sequence[Result]) -> str:
    """The name of the board of held-out tasks that a method belongs to; empty for none.

    If any of a method's runs was pre-trained, all must be, on training tasks alone and with the
    same number of demonstrations, one of `FINE_TUNED`. Otherwise all runs must have `DEMOS`
    demonstrations, if they state a number, and no extra data.
    """
    details = [run.entry.details for run in runs]
    stated_numbers = [stated.get(NUM_DEMOS) for stated in details]
    if not all(isinstance(number, int | None) for number in stated_numbers):
        return ""
    numbers = set(stated_numbers)
    if not any(PRETRAINED_ON in stated for stated in details):
        extra = any(EXTRA_DATA in learned_from(stated) for stated in details)
        return HELD_OUT_TASKS if numbers <= {DEMOS, None} and not extra else ""
    allowed = set(suites().get(TRAINING_TASKS, ()))
    before = [stated.get(PRETRAINED_ON) for stated in details]
    if not all(isinstance(tasks, list) and allowed.issuperset(map(str, tasks)) for tasks in before):
        return ""
    return next((pretrained_board(n) for n in FINE_TUNED if numbers == {n}), "")


def _method(runs: Sequence[Result]) -> ComparedMethod:
    (method,) = compared_methods(replace(run.entry, nudge=0.0) for run in runs)
    return method


def _on_tasks(method: ComparedMethod, tasks: Collection[str]) -> ComparedMethod | None:
    """The method on these tasks; `None` if it lacks any of them."""
    env_ids = [env_id for env_id in method.env_ids if env_id.task in tasks]
    return method.on(env_ids) if {env_id.task for env_id in env_ids} >= set(tasks) else None


def _used(result: Result) -> tuple[str, ...]:
    state = (STATE,) if result.entry.privileged else ()
    return (*learned_from(result.entry.details), *state)


def _standing(method: ComparedMethod, runs: Sequence[Result]) -> Standing:
    def on(variant: str) -> ComparedMethod:
        return method.on([i for i in method.env_ids if i.variant == variant])

    gap = method.generalisation_gap()
    assert gap is not None  # entries with all variants have Demo and TestAll
    return Standing(
        runs[0].entry.method,
        method.unit,
        on(TEST_ALL).mean(),
        on(DEMO).mean(),
        gap,
        label=with_conditions(runs[0].entry.method, [run.entry for run in runs]),
        runs_apart=on(TEST_ALL).means_apart(),
        used=_used(runs[0]),  # the same in all runs
        statements=gather_statements(run.entry.details for run in runs),
        runs=method.fewest_runs,
    )


def _ranked(standings: Sequence[Standing]) -> list[Standing]:
    """The standings with their ranks, sorted by TestAll, then by the gap, then by name.

    References get the rank that they would have, but do not affect the ranks of others. Nor do
    methods of too few runs, which come last.
    """
    ranked = [row for row in standings if row.is_ranked]
    few = [row for row in standings if not (row.is_ranked or row.is_reference)]

    def order(row: Standing) -> tuple[int, bool, int, str]:
        return row.rank, not row.is_reference, row.gap_rank, row.method

    first = [_with_ranks(row, ranked) for row in standings if row not in few]
    return sorted(first, key=order) + sorted((_with_ranks(row, few) for row in few), key=order)


def _with_ranks(row: Standing, others: Sequence[Standing]) -> Standing:
    return replace(
        row,
        rank=_rank(row, others, lambda other: -other.test_all.value),
        gap_rank=_rank(row, others, lambda other: other.gap.value),
    )


def _rank(row: Standing, standings: Sequence[Standing], key: Callable[[Standing], float]) -> int:
    return 1 + sum(key(other) < key(row) - ROUNDING for other in standings)
