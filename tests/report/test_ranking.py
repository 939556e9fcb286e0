"""Methods in order."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from magical.evaluation.statistics import OverRollouts
from magical.report import leaderboard
from magical.report.found import Result
from magical.report.leaderboard import (
    ALL_TASKS,
    HELD_OUT_TASKS,
    WITH_PRIOR,
    make_boards,
)
from magical.report.table import interval_text
from magical.tasks import TASKS
from tests.report.conftest import make_entry

generated = pytest.importorskip("magical_goals.language.generated")
HELD_OUT = list(generated.HELD_OUT)


def run(
    method: str, demo: float, test_all: float, tasks: Sequence[str] = ("MakeLine",), **fields: Any
) -> Result:
    means = {"Demo": demo, "TestAll": test_all}
    scores = {f"{task}-{name}": [mean] for task in tasks for name, mean in means.items()}
    record = fields.pop("record", {"learned_from": ["demonstrations"]})
    return Result(Path(method), make_entry(method, scores, nudge=1e-9, record=record, **fields))


def thrice(*results: Result) -> list[Result]:
    """As many runs as a rank needs."""
    return [result for result in results for _ in range(3)]


def test_methods_are_ranked_by_test_all_and_by_gap() -> None:
    results = [
        *thrice(run("low", 0.3, 0.2)),
        run("high", 0.81, 0.6),
        *thrice(run("flat", 0.5, 0.5)),
        run("high", 0.79, 0.6),
        run("high", 0.80, 0.6),
    ]
    everything, board = make_boards(results)
    assert everything.name == ALL_TASKS
    assert everything.standings == []
    assert board.name == "MakeLine"
    assert [(row.method, row.rank, row.gap_rank) for row in board.standings] == [
        ("high", 1, 3),
        ("flat", 2, 1),
        ("low", 3, 2),
    ]
    high = board.standings[0]
    # Three runs: the gaps 0.21, 0.19 and 0.20 have the standard deviation 0.01; t(2) = 4.302653.
    half = 4.302653 * 0.01 / 3**0.5
    assert high.gap == pytest.approx((0.2, 0.2 - half, 0.2 + half))
    assert high.test_all.value == pytest.approx(0.6)
    assert high.unit == "3 runs"
    # On TestAll they do not differ.
    assert isinstance(high.test_all, OverRollouts)
    assert interval_text(high.test_all, high.unit).endswith(" over rollouts")


def test_methods_of_fewer_than_three_runs_come_last_without_a_rank() -> None:
    results = [
        run("two runs", 1.0, 0.9),
        run("two runs", 1.0, 0.8),
        run("one run", 1.0, 1.0),
        *thrice(run("three runs", 0.5, 0.4), run("four runs", 0.6, 0.3)),
        run("four runs", 0.6, 0.3),
        run("learned nothing", 0.6, 0.35, record={"learned_from": []}),
    ]
    standings = make_boards(results)[1].standings
    few = "not ranked: fewer than 3 runs"
    assert [(row.method, row.place, row.gap_place) for row in standings] == [
        ("three runs", "1", "1"),
        ("learned nothing", "2", "2"),
        ("four runs", "3", "3"),
        ("one run", few, "–"),
        ("two runs", few, "–"),
    ]
    assert standings[-1].unit.endswith("2 runs")
    everywhere = [task for task in TASKS if task != "MakeLine"]
    results = [*thrice(run("m", 0.5, 0.4, everywhere)), run("m", 0.5, 0.4)]
    places = {board.name: board.standings[0].place for board in make_boards(results)}
    assert (places[ALL_TASKS], places["MakeLine"], places["FindDupe"]) == (few, few, "1")


def test_another_registered_task_is_not_one_of_the_paper(monkeypatch: pytest.MonkeyPatch) -> None:
    results = [run("a", 0.5, 0.4, [task]) for task in TASKS]
    with_more = {**TASKS, "Mine": replace(TASKS["MakeLine"], name="Mine")}
    monkeypatch.setattr(leaderboard, "TASKS", with_more)
    assert [row.method for row in make_boards(results)[0].standings] == ["a"]


def test_what_learned_nothing_from_true_states_is_a_reference_without_a_rank() -> None:
    expert = run("expert", 1.0, 0.9, record={"learned_from": []}, privileged=True)
    learned = run("learned from states", 1.0, 0.8, privileged=True)
    others = thrice(run("b", 0.9, 0.5), learned, run("a", 1.0, 0.7))
    board = make_boards([*others, expert])[1]
    assert [(row.method, row.is_reference) for row in board.standings] == [
        ("expert", True),
        ("learned from states", False),
        ("a", False),
        ("b", False),
    ]
    assert [row.rank for row in board.standings[1:]] == [1, 2, 3]
    assert board.standings[1].label == "learned from states (sees the state)"


def test_few_runs_of_which_some_fail_are_listed() -> None:
    (row,) = make_boards([run("a", 1.0, score) for score in (1.0, 0.0, 1.0)])[1].standings
    assert row.runs_apart == " (1.00, 0.00, 1.00)"


def test_equal_scores_share_a_rank() -> None:
    board = make_boards(thrice(run("b", 0.5, 0.5), run("a", 0.6, 0.5), run("c", 0.4, 0.4)))[1]
    assert [(row.method, row.rank) for row in board.standings] == [("b", 1), ("a", 1), ("c", 3)]
    runs = thrice(*(run("six runs", 0.5, mean) for mean in (0.1, 0.2)))  # whose mean is rounded
    board = make_boards([*thrice(run("three runs", 0.5, 0.15)), *runs])[1]
    assert [row.rank for row in board.standings] == [1, 1]


def test_methods_with_all_tasks_have_a_board_of_their_own() -> None:
    single = [run("single", 0.9, 0.4, [task]) for task in TASKS]
    boards = make_boards([*single, run("multi", 0.8, 0.5, list(TASKS)), run("part", 1.0, 1.0)])
    assert [board.name for board in boards] == [ALL_TASKS, *TASKS]
    assert [row.method for row in boards[0].standings] == ["multi", "single"]
    assert boards[0].standings[1].gap.value == pytest.approx(0.5)
    line = next(board for board in boards if board.name == "MakeLine")
    assert [row.method for row in line.standings] == ["part", "multi", "single"]


def test_methods_with_all_held_out_tasks_have_a_board_of_their_own() -> None:
    results = [run("a", 0.9, 0.5, [*TASKS, *HELD_OUT]), run("b", 1.0, 0.7, HELD_OUT[1:])]
    results.append(run("c", 1.0, 0.9, [*HELD_OUT, "MakeLine"]))
    everything, suite, *tasks = make_boards(results)
    assert [row.method for row in everything.standings] == ["a"]
    assert (suite.name, [row.method for row in suite.standings]) == (HELD_OUT_TASKS, ["c", "a"])
    assert [board.name for board in tasks] == list(TASKS)


def test_methods_that_learned_from_more_are_not_on_the_held_out_board() -> None:
    held_out = HELD_OUT
    learned = {"learned_from": ["demonstrations"]}
    records = {
        "ten": {**learned, "num_demos": 10},
        "hundred": {**learned, "num_demos": 100},
        "pre-trained": {**learned, "pretrained_on": held_out[:1]},
        "extra data": {"learned_from": ["demonstrations", "extra data"]},
    }
    results = [run(name, 0.9, 0.5, held_out, record=record) for name, record in records.items()]
    boards = {board.name: [row.method for row in board.standings] for board in make_boards(results)}
    assert boards == {ALL_TASKS: [], HELD_OUT_TASKS: ["ten"]}


def test_methods_with_a_prior_made_for_the_benchmark_are_ranked_apart() -> None:
    details = {"learned_from": ["demonstrations", "benchmark prior"]}
    prior = [
        run(name, 0.9, score, list(TASKS), record=details) for name, score in (("a", 0.8), ("b", 1))
    ]
    results = thrice(*prior, run("c", 0.9, 0.1, list(TASKS)))
    boards = {board.name: board for board in make_boards(results)}
    for name in (ALL_TASKS, "MakeLine"):
        assert [(row.method, row.rank) for row in boards[name].standings] == [("c", 1)]
        apart = [(r.method, r.rank, r.track) for r in boards[name + WITH_PRIOR].standings]
        assert apart == [("b", 1, "B"), ("a", 2, "B")]


def test_what_was_used_is_what_was_learned_from_and_shown() -> None:
    details = {"learned_from": ["extra data", "demonstrations"]}
    board = make_boards([run("m", 1.0, 1.0, record=details, privileged=True)])[1]
    assert board.standings[0].used == ("demonstrations", "extra data", "state")


def test_demonstrations_and_looks_are_as_the_entries_say() -> None:
    learned = {"learned_from": ["demonstrations"]}
    results = [
        run(
            "m", 1.0, 0.9, record={**learned, "demonstrations": "10 (human)", "test_evaluations": 2}
        ),
        run(
            "m", 1.0, 0.8, record={**learned, "demonstrations": "10 (human)", "test_evaluations": 7}
        ),
        run("m", 1.0, 0.85, record={**learned, "demonstrations": "25 (expert)"}),
        run("n", 1.0, 0.7, record=learned),
    ]
    results.append(run("o", 1.0, 0.6, record={**learned, "test_evaluations": 0}))
    stated = [row.statements for row in make_boards(results)[1].standings]
    assert stated == [("10 (human); 25 (expert)", 7), ("", None), ("", 0)]
    assert [each.mark for each in stated] == ["†", "", ""]


def test_a_method_stands_on_each_board_by_its_runs_there() -> None:
    results = [
        run("a", 0.9, 0.8, list(TASKS), record=demos(100)),
        run("a", 0.5, 0.1, HELD_OUT, record=demos(10)),
    ]
    boards = {board.name: board.standings for board in make_boards(results)}
    (paper,), (generated,) = boards[ALL_TASKS], boards[HELD_OUT_TASKS]
    assert paper.demo.value == pytest.approx(0.9)
    assert paper.test_all.value == pytest.approx(0.8)
    assert generated.test_all.value == pytest.approx(0.1)
    assert paper.statements.demonstrations == "100 of each task"


def demos(number: int) -> dict[str, Any]:
    said = f"{number} of each task"
    return {"learned_from": ["demonstrations"], "num_demos": number, "demonstrations": said}
