"""Whether entries follow the protocol, methods in order, the leaderboard's pages."""

import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from magical import cli
from magical.errors import RunFolderError
from magical.evaluation import Entry
from magical.evaluation.policy import FunctionPolicy, observed
from magical.evaluation.protocol import NUDGE, ROLLOUTS
from magical.evaluation.statistics import OverRollouts
from magical.observe import Observation, PixelSpec
from magical.report import leaderboard
from magical.report.found import Found, Result, Skipped
from magical.report.leaderboard import (
    ALL_TASKS,
    HELD_OUT_TASKS,
    WITH_PRIOR,
    Standing,
    check_entries,
    faults,
    make_boards,
    make_leaderboard,
)
from magical.report.table import interval_text
from magical.tasks import TASKS, get_task
from tests.report.conftest import WriteEntry, make_entry

LEARNED: dict[str, Any] = {"learned_from": ["demonstrations"]}
REGION = [f"MoveToRegion-{variant}" for variant in get_task("MoveToRegion").variants]
RIGHT: dict[str, Any] = {"observation": "LoRes4E", "nudge": NUDGE, "record": LEARNED}


def entry(score: float = 0.5, **fields: Any) -> Entry:
    """An entry on one task with which nothing is wrong."""
    return make_entry("m", {env: [score] * ROLLOUTS for env in REGION}, **(RIGHT | fields))


def test_a_right_entry_has_no_faults() -> None:
    assert faults(entry()) == []
    assert faults(entry(record={"learned_from": [], "test_evaluations": 0})) == []
    assert faults(entry(version="0.1.0")) == []  # whose scores are those of 1.0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"horizon": "41"}, "horizon 41"),
        ({"nudge": 0.0}, "nudge 0, expected 1e-09"),
        ({"seed": 1}, "set 1 of fixed seeds"),
        ({"record": {}}, "expected learned_from in the record"),
        ({"record": {"learned_from": [], "updates": (25, 600)}}, "(25 of 600 updates)"),
        ({"observation": ""}, "observation '' is unknown here"),
        ({"observation": "state_vector:SPEC"}, "'state_vector:SPEC' is unknown here"),
        ({"observation": '{"size": 1e9}'}, "observation: size: expected int"),
        ({"version": ""}, "made by version (not stated)"),
        ({"version": "0.2.0"}, "made by version 0.2.0"),
        ({"version": "99.1.0"}, "made by version 99.1.0"),
    ],
)
def test_every_fault_is_named(fields: dict[str, Any], message: str) -> None:
    (found,) = faults(entry(**fields))
    assert message in found


def test_missing_variants_and_rollouts_are_named() -> None:
    found = faults(make_entry("m", {env: [0.5] * 10 for env in REGION[:-1]}, **RIGHT))
    assert found[0] == f"10 rollouts of each environment, expected {ROLLOUTS}"
    assert found[1].startswith("MoveToRegion without All")


@pytest.mark.parametrize(
    "observation", [{"parts": [["allo", 2]], "size": 64}, PixelSpec(size=32), "raw", None]
)
def test_images_of_any_settings_can_be_ranked(observation: Observation) -> None:
    named, privileged = observed(FunctionPolicy(print), observation, get_task("MoveToRegion"))
    assert faults(entry(observation=named, privileged=privileged)) == []


def check(*entries: Entry) -> list[tuple[str, str]]:
    """The folders of rejected entries, which are numbers, and the first reason of each."""
    results = [Result(Path(str(number)), entry) for number, entry in enumerate(entries)]
    accepted, rejected = check_entries(Found(results))
    assert len(accepted) + len(rejected) == len(entries)
    return [(item.folder, item.reasons[0]) for item in rejected]


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"observation": "LoRes4A"}, "LoRes4A, but 0 of the same method has LoRes4E"),
        ({"privileged": True}, "privileged: True"),
        ({"action_space": "continuous"}, "action space: continuous"),
        ({"record": {"learned_from": []}}, "learned from: nothing"),
    ],
)
def test_runs_of_a_method_agree(fields: dict[str, Any], reason: str) -> None:
    first, other = entry(0.1), entry(0.2, **fields)
    ((folder, found),) = check(first, other)
    assert folder == "1"
    assert reason in found
    assert check(first, entry(0.2), replace(other, method="another")) == []


def test_a_run_counts_once() -> None:
    telling = [row._replace(score=row.rollout / ROLLOUTS) for row in entry().scores]
    first = replace(entry(), scores=telling)
    backwards = replace(first, scores=list(reversed(telling)))
    ((folder, reason),) = check(first, backwards, replace(first, method="another"))
    assert (folder, reason[:13]) == ("1", "the same run ")
    assert check(entry(), entry()) == []  # runs that score alike nearly everywhere
    one, other = ({"record": {**LEARNED, "training_seed": seed}} for seed in (0, 1))
    assert check(entry(1.0, **one), entry(1.0, **other)) == []  # both always succeed
    assert [folder for folder, _ in check(entry(1.0, **one), entry(0.5, **one))] == ["1"]
    # A rejected entry does not stand against others.
    assert [folder for folder, _ in check(entry(horizon="41"), entry())] == ["0"]


def test_what_was_skipped_or_is_contradicted_by_its_run_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(json.dumps({"observation": "state"}))
    found = Found([Result(tmp_path, entry(), tmp_path)], [Skipped(Path("x"), "damaged")])
    accepted, rejected = check_entries(found)
    assert accepted == []
    assert rejected[0] == ("x", "", ["damaged"])
    assert rejected[1].reasons == ["observation LoRes4E, but its run was trained on state"]


def run(
    method: str, demo: float, test_all: float, tasks: Sequence[str] = ("MakeLine",), **fields: Any
) -> Result:
    means = {"Demo": demo, "TestAll": test_all}
    scores = {f"{task}-{name}": [mean] for task in tasks for name, mean in means.items()}
    record = fields.pop("record", LEARNED)
    return Result(Path(method), make_entry(method, scores, nudge=1e-9, record=record, **fields))


def thrice(*results: Result) -> list[Result]:
    """As many runs as a rank needs."""
    return [result for result in results for _ in range(3)]


def standings(*results: Result, board: str = "MakeLine") -> Sequence[Standing]:
    """The standings on a board."""
    return dict(make_boards(results))[board]


def test_methods_are_ranked_by_test_all_and_by_gap() -> None:
    high = [run("high", demo, 0.6) for demo in (0.81, 0.79, 0.80)]
    results = [*thrice(run("low", 0.3, 0.2)), *high, *thrice(run("flat", 0.5, 0.5))]
    assert standings(*results, board=ALL_TASKS) == []
    found = standings(*results)
    assert [(row.method, row.rank, row.gap_rank) for row in found] == [
        ("high", 1, 3),
        ("flat", 2, 1),
        ("low", 3, 2),
    ]
    # Three runs: the gaps 0.21, 0.19 and 0.20 have the standard deviation 0.01; t(2) = 4.302653.
    half = 4.302653 * 0.01 / 3**0.5
    assert found[0].gap == pytest.approx((0.2, 0.2 - half, 0.2 + half))
    assert (found[0].test_all.value, found[0].unit) == (pytest.approx(0.6), "3 runs")
    # On TestAll they do not differ.
    assert isinstance(found[0].test_all, OverRollouts)
    assert interval_text(found[0].test_all, found[0].unit).endswith(" over rollouts")


def test_equal_scores_share_a_rank() -> None:
    found = standings(*thrice(run("b", 0.5, 0.5), run("a", 0.6, 0.5), run("c", 0.4, 0.4)))
    assert [(row.method, row.rank) for row in found] == [("b", 1), ("a", 1), ("c", 3)]
    runs = thrice(*(run("six runs", 0.5, mean) for mean in (0.1, 0.2)))  # whose mean is rounded
    assert [r.rank for r in standings(*thrice(run("three runs", 0.5, 0.15)), *runs)] == [1, 1]


def test_methods_of_fewer_than_three_runs_come_last_without_a_rank() -> None:
    found = standings(
        run("two runs", 1.0, 0.9),
        run("two runs", 1.0, 0.0),
        run("one run", 1.0, 1.0),
        *thrice(run("three runs", 0.5, 0.4), run("four runs", 0.6, 0.3)),
        run("four runs", 0.6, 0.3),
        run("learned nothing", 0.6, 0.35, record={"learned_from": []}),
    )
    few = "not ranked: fewer than 3 runs"
    assert [(row.method, row.place, row.gap_place) for row in found] == [
        ("three runs", "1", "1"),
        ("learned nothing", "2", "2"),
        ("four runs", "3", "3"),
        ("one run", few, "–"),
        ("two runs", few, "–"),
    ]
    assert (found[-1].unit, found[-1].runs_apart) == ("rollouts of 2 runs", " (0.90, 0.00)")
    everywhere = [task for task in TASKS if task != "MakeLine"]
    results = [*thrice(run("m", 0.5, 0.4, everywhere)), run("m", 0.5, 0.4)]
    places = {name: rows[0].place for name, rows in make_boards(results)}
    assert (places[ALL_TASKS], places["MakeLine"], places["FindDupe"]) == (few, few, "1")


def test_what_learned_nothing_from_true_states_is_a_reference_without_a_rank() -> None:
    expert = run("expert", 1.0, 0.9, record={"learned_from": []}, privileged=True)
    extra = {"learned_from": ["extra data", "demonstrations"]}
    learned = run("learned from states", 1.0, 0.8, privileged=True, record=extra)
    found = standings(*thrice(run("b", 0.9, 0.5), learned, run("a", 1.0, 0.7)), expert)
    assert [(row.label, row.is_reference, row.rank) for row in found] == [
        ("expert (sees the state)", True, 1),
        ("learned from states (sees the state)", False, 1),
        ("a", False, 2),
        ("b", False, 3),
    ]
    assert found[1].used == ("demonstrations", "extra data", "state")


def test_methods_with_all_tasks_have_a_board_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    single = [run("single", 0.9, 0.4, [task]) for task in TASKS]
    results = [*single, run("multi", 0.8, 0.5, list(TASKS)), run("part", 1.0, 1.0)]
    boards = make_boards(results)
    assert [name for name, _ in boards] == [ALL_TASKS, *TASKS]
    assert [row.method for row in boards[0].standings] == ["multi", "single"]
    assert boards[0].standings[1].gap.value == pytest.approx(0.5)
    assert [row.method for row in dict(boards)["MakeLine"]] == ["part", "multi", "single"]
    # Another registered task is not one of the paper's.
    with_more = {**TASKS, "Mine": replace(TASKS["MakeLine"], name="Mine")}
    monkeypatch.setattr(leaderboard, "TASKS", with_more)
    assert len(standings(*results, board=ALL_TASKS)) == 2


def test_the_held_out_board_is_of_ten_demonstrations_of_each_of_its_tasks() -> None:
    held_out = list(pytest.importorskip("magical_goals.language.generated").HELD_OUT)
    records = {
        "ten": {**LEARNED, "num_demos": 10},
        "hundred": {**LEARNED, "num_demos": 100},
        "pre-trained": {**LEARNED, "pretrained_on": held_out[:1]},
        "extra data": {"learned_from": ["demonstrations", "extra data"]},
    }
    results = [run(name, 0.9, 0.5, held_out, record=record) for name, record in records.items()]
    results += [run("part", 1.0, 0.7, held_out[1:]), run("ten", 1.0, 0.8, list(TASKS))]
    boards = dict(make_boards(results))
    assert list(boards) == [ALL_TASKS, HELD_OUT_TASKS, *TASKS]
    ((paper,), (generated,)) = boards[ALL_TASKS], boards[HELD_OUT_TASKS]
    assert paper.method == generated.method == "ten"
    assert (paper.test_all.value, generated.test_all.value) == pytest.approx((0.8, 0.5))


def test_methods_with_a_prior_made_for_the_benchmark_are_ranked_apart() -> None:
    record = {"learned_from": ["demonstrations", "benchmark prior"]}
    prior = [
        run(name, 0.9, score, list(TASKS), record=record) for name, score in [("a", 0.8), ("b", 1)]
    ]
    boards = dict(make_boards(thrice(*prior, run("c", 0.9, 0.1, list(TASKS)))))
    for name in (ALL_TASKS, "MakeLine"):
        assert [(row.method, row.rank) for row in boards[name]] == [("c", 1)]
        apart = [(row.method, row.rank, row.track) for row in boards[name + WITH_PRIOR]]
        assert apart == [("b", 1, "B"), ("a", 2, "B")]


@pytest.fixture
def entries(write_entry: WriteEntry, tmp_path: Path) -> Path:
    pytest.importorskip("jinja2", reason="the report extra is not installed")
    pytest.importorskip("matplotlib", reason="the report extra is not installed")
    record = {**LEARNED, "demonstrations": "<5>", "test_evaluations": 0}
    scores = {env: [0.5] * ROLLOUTS for env in REGION}
    right = RIGHT | {"record": record}
    write_entry("in/a", "<A> & b", scores, 0, **right)
    better = {name: [1.0] * ROLLOUTS for name in scores}
    write_entry("in/c", "C", better, **right | {"record": {"learned_from": []}})
    write_entry("in/\x1b[2Jold", "old", scores, **right | {"version": "0.0.1"})
    (write_entry("in/bad", "bad", scores, **right) / "entry.json").write_text("{")
    return tmp_path / "in"


def test_the_site_is_whole(
    entries: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = tmp_path / "site"
    argv = ["leaderboard", str(entries), "--out", str(site), "--rerun"]
    shutil.copytree(entries / "\x1b[2Jold", entries / "old")
    assert cli.main([*argv, "C", "--json"]) == 0
    *printed, last = capsys.readouterr().out.splitlines()
    shown = "\n".join(printed)
    assert "no method has entries on all tasks" in shown
    assert "\\x1b[2Jold and 1 more: made by version 0.0.1" in shown
    assert re.search(r"C .*\n.*<A> & b .* P +demonstrations", shown)
    found = json.loads(last)
    assert (found["boards"]["All tasks"], len(found["rejected"])) == ([], 3)
    first, second = found["boards"]["MoveToRegion"]
    assert (first["method"], first["rank"], first["test_all"][0]) == ("C", 1, 1.0)
    assert (second["rank"], second["rank_by_gap"]) == (None, None)  # one run that learned
    assert (second["used"], second["track"]) == (["demonstrations"], "P")
    text = (site / "index.html").read_text()
    for words in (
        *("&lt;A&gt; &amp; b", "No method has entries on all tasks.", "expected JSON"),
        *('data-used="demonstrations"', "Scores are as submitted, unless marked"),
        *("<dt>nudge</dt>", "<dt>test evaluations, †</dt>"),
        "<details><summary>2 entries: made by version 0.0.1",
        f"<li>{entries / 'old'} (old)</li>",
    ):
        assert words in text
    assert text.count("<small>rerun</small>") == 1
    stated = re.findall('<td>([^<]*)</td><td class="words">([^<]*)</td><td>([^<]*)</td>', text)
    assert stated == [("–", "–", "–"), ("P", "&lt;5&gt;", "0")]
    for page in site.rglob("*.html"):
        for address in re.findall(r'(?:src|href)="([^#"][^"]+)"', page.read_text()):
            assert not address.startswith(("http", "//"))
            assert address.startswith("data:") or (page.parent / address).is_file()
    assert cli.main([*argv, "old"]) == 2
    assert "expected ranked methods to mark as rerun, found ['old']" in capsys.readouterr().err


def test_a_site_among_the_entries_is_renewed(entries: Path) -> None:
    make_leaderboard([entries]).write(entries)
    first = (entries / "index.html").read_text()
    board = make_leaderboard([entries])
    board.write(entries)
    assert (entries / "index.html").read_text() == first
    shutil.rmtree(entries / "a")
    make_leaderboard([entries]).write(entries)
    assert [path.name for path in (entries / "methods").iterdir()] == ["001-c.html"]


def test_what_is_no_leaderboard_is_named_and_not_overwritten(
    entries: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = make_leaderboard([entries / "bad"])
    (tmp_path / "index.html").write_text("mine")
    mine = tmp_path / "site" / "methods" / "001-mine"
    mine.mkdir(parents=True)
    for site in (tmp_path, tmp_path / "site"):
        with pytest.raises(RunFolderError, match=r"expected no pages or a leaderboard's"):
            board.write(site)
    assert (tmp_path / "index.html").read_text() == "mine"
    assert mine.is_dir()
    assert cli.main(["leaderboard", str(tmp_path / "missing")]) == 1
    assert f"{tmp_path / 'missing'}: expected a folder" in capsys.readouterr().err
