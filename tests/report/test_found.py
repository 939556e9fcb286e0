"""Evaluated runs in folders."""

from pathlib import Path

import pytest

from magical import cli
from magical.errors import ScoresError
from magical.evaluation import read_entry
from magical.evaluation.entry import write_collection
from magical.report.found import find_results, search_results
from magical.report.page import write_page
from magical.runs import write_json
from tests.report.conftest import WriteEntry

LINE = {"MakeLine-Demo": [1.0, 0.0]}
REGION = {
    f"MoveToRegion-{variant}": [1.0]
    for variant in ("Demo", "TestJitter", "TestLayout", "TestColour", "TestDynamics", "TestAll")
}


def write_plan(folder: Path, *names: str, task: str = "MakeLine") -> None:
    """Write the plan of runs in folders of these names, with the seeds 0, 1, and so on."""
    run = {"method": "a", "tasks": [task], "total": 1}
    runs = [{**run, "folder": name, "seed": seed} for seed, name in enumerate(names)]
    write_json(folder / "plan.json", {"runs": runs})


def test_entries_are_found_at_any_depth_in_order(write_entry: WriteEntry, tmp_path: Path) -> None:
    for name in ("b/run", "a", "b/other/deep", "b/.hidden"):
        write_entry(name, name, LINE)
    found = find_results([tmp_path]).results
    assert [result.entry.method for result in found] == ["a", "b/other/deep", "b/run"]
    again = find_results([tmp_path / "b", tmp_path]).results
    assert [result.entry.method for result in again] == ["b/other/deep", "b/run", "a"]


def test_an_entry_belongs_to_the_run_beside_or_around_it(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_entry("own", "own", LINE, seed=1)
    write_entry("around/evaluation", "around", LINE)
    write_json(tmp_path / "around" / "config.json", {"seed": 2, "tasks": ["MakeLine"]})
    write_entry("inside", "inside", LINE, record={"policy": "run"})
    write_json(tmp_path / "inside" / "run" / "config.json", {"seed": 3, "tasks": ["MakeLine"]})
    write_entry("alone", "alone", LINE, record={"training_seed": 4})
    found = find_results([tmp_path])
    assert {r.entry.method: r.seed for r in found.results} == {
        "own": 1,
        "around": 2,
        "inside": 3,
        "alone": 4,
    }


def test_collections_are_read_like_folders(write_entry: WriteEntry, tmp_path: Path) -> None:
    write_entry("a", "a", LINE)
    folder = tmp_path / "many"
    write_collection(
        folder, {"runs/b": read_entry(tmp_path / "a"), "runs/old": read_entry(tmp_path / "a")}
    )
    write_plan(folder, "b")
    write_entry("half", "half", LINE).rename(tmp_path / "other")
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "entries.json").write_text("{}")
    found = search_results([tmp_path])
    names = [result.folder.relative_to(tmp_path).as_posix() for result in found.results]
    assert names == ["a", "many/runs/b", "other"]
    assert [item.folder.name for item in found.skipped] == ["damaged", "old"]


def test_damaged_entries_are_skipped_by_name(write_entry: WriteEntry, tmp_path: Path) -> None:
    write_entry("good", "good", LINE)
    (write_entry("bad", "bad", LINE) / "scores.csv").write_text("nothing")
    (write_entry("deep", "deep", LINE) / "entry.json").write_text("[" * 100_000)
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "entry.json").write_text("{}")
    found = find_results([tmp_path])
    assert [result.entry.method for result in found.results] == ["good"]
    assert [item.folder.name for item in found.skipped] == ["bad", "deep", "half"]
    assert "expected the header" in found.skipped[0].reason
    assert "no scores.csv" in found.skipped[2].reason


def test_nothing_but_damaged_entries_is_an_error(write_entry: WriteEntry, tmp_path: Path) -> None:
    (write_entry("bad", "bad", LINE) / "scores.csv").write_text("nothing")
    with pytest.raises(ScoresError, match="expected the header"):
        find_results([tmp_path])
    with pytest.raises(ScoresError, match="expected a folder with"):
        find_results([tmp_path / "missing"])


def test_a_run_that_a_collection_has_too_counts_once(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    folder = write_entry("runs/a", "a", LINE)
    write_collection(tmp_path, {"runs/a": read_entry(folder)})
    found = find_results([tmp_path])
    assert [result.folder for result in found.results] == [folder]
    assert [item.folder for item in found.skipped] == [folder]


@pytest.mark.parametrize("seed", [None, 0])
def test_of_two_evaluations_of_a_run_the_more_complete_one_counts(
    write_entry: WriteEntry, tmp_path: Path, seed: int | None
) -> None:
    scores = {"MakeLine-Demo": [0.0, 0.5, 1.0] * 30, "MakeLine-TestAll": [0.0, 1.0] * 45}
    write_entry("a-look", "m", {"MakeLine-Demo": scores["MakeLine-Demo"]}, seed=seed)
    write_entry("whole", "m", scores, seed=seed)
    found = find_results([tmp_path])
    assert [result.folder.name for result in found.results] == ["whole"]
    assert [item.folder.name for item in found.skipped] == ["a-look"]


def test_runs_that_are_no_longer_of_the_plan_are_skipped(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_entry("runs/done", "a", REGION, seed=0)
    write_plan(tmp_path, "done", "waiting", task="MoveToRegion")
    write_entry("runs/earlier", "a", REGION, seed=9)
    found = find_results([tmp_path])
    assert [result.folder.name for result in found.results] == ["done"]
    assert [item.folder.name for item in found.skipped] == ["earlier"]


def test_escape_sequences_in_names_do_not_reach_the_terminal(
    write_entry: WriteEntry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_entry("runs/\x1b[2Jdone", "a", REGION, seed=0)
    write_entry("runs/\x1b[2Jcopy", "a", REGION, seed=0)
    write_entry("runs/\x1b[2Jdamaged", "a", REGION)
    (tmp_path / "runs" / "\x1b[2Jdamaged" / "scores.csv").write_text("nothing")
    plan = {"folder": "x", "method": "\x1b[2J", "tasks": ["\x1b[2J"], "seed": 0, "total": 1}
    write_json(tmp_path / "experiment.json", {})
    for command in ("report", "leaderboard", "status"):
        if command == "status":
            write_json(tmp_path / "plan.json", {"runs": [plan]})
            write_json(
                tmp_path / "runs" / "x" / "result.json", {"state": "failed", "error": "\x1b"}
            )
        assert cli.main([command, str(tmp_path)]) == 0
        shown = capsys.readouterr()
        assert "\x1b" not in shown.out + shown.err
        assert "\\x1b[2J" in shown.out + shown.err
    assert cli.main(["report", str(tmp_path / "runs" / "\x1b[2Jdamaged")]) == 1
    assert "\\x1b[2Jdamaged" in capsys.readouterr().err


def test_a_training_run_counts_once_in_a_row(write_entry: WriteEntry, tmp_path: Path) -> None:
    write_entry("a", "bc", LINE, seed=0, record={"date": "2050-01-01"})
    write_entry("another-set-of-seeds", "bc", {"MakeLine-Demo": [0.0, 0.0]}, seed=0)
    write_entry("b", "bc", LINE, seed=1)  # equal scores, another run
    write_entry("nudged", "bc", LINE, seed=0, nudge=1e-9)  # another row
    write_entry("third", "mine", LINE)
    write_entry("third-alike", "mine", LINE)  # too few scores to tell
    found = find_results([tmp_path])
    names = [result.folder.name for result in found.results]
    assert names == ["a", "b", "nudged", "third", "third-alike"]
    assert [item.folder.name for item in found.skipped] == ["another-set-of-seeds"]
    assert found.skipped[0].reason.endswith("a: each run counts only once in a table row")


def test_copies_with_other_seeds_are_one_run(write_entry: WriteEntry, tmp_path: Path) -> None:
    telling = {"MakeLine-Demo": [i / 50 for i in range(50)]}
    perfect = {"MoveToRegion-Demo": [1.0] * 45 + [0.5] * 5}
    for seed in range(3):
        record = {"date": f"205{3 - seed}-01-01"}
        write_entry(f"copy{seed}", "bc", telling, seed=seed, record=record)
        write_entry(f"perfect{seed}", "bc", perfect, seed=seed)
    found = find_results([tmp_path])
    names = ["copy0", "perfect0", "perfect1", "perfect2"]
    assert [result.folder.name for result in found.results] == names


def test_runs_of_other_settings_are_other_runs(write_entry: WriteEntry, tmp_path: Path) -> None:
    for name in ("a", "b"):
        folder = write_entry(name, "bc", LINE, seed=0)
        write_json(folder / "config.json", {"seed": 0, "tasks": ["MakeLine"], "augment": name})
    assert len(find_results([tmp_path]).results) == 2


def test_a_policy_in_the_package_has_no_training_run(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_entry("par", "random", LINE, record={"policy": "random"})
    write_entry("par/bc", "bc", LINE, seed=7)
    by_method = {result.entry.method: result for result in find_results([tmp_path]).results}
    assert (by_method["random"].run, by_method["random"].seed) == (None, None)
    assert by_method["bc"].seed == 7


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"demonstrations": 5}', '{"steps": ' + "9" * 400 + "}", '"\\ud800"']
)
def test_a_damaged_record_of_a_run_does_not_stop_a_page(
    write_entry: WriteEntry, tmp_path: Path, text: str
) -> None:
    folder = write_entry("a", "bc", LINE, seed=1)
    for name in ("run.json", "result.json", "metrics.jsonl"):
        (folder / name).write_text(text + "\n")
    site = tmp_path / "page.html"
    write_page(site, "a", find_results([tmp_path]))
    assert "bc" in site.read_text("utf-8")


def test_entries_inside_a_run_that_is_no_longer_the_plans_are_skipped(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    for name in ("runs/old/leaderboard", "runs/now/leaderboard", "runs/now"):
        write_entry(name, "bc", LINE)
    write_plan(tmp_path, "now")
    found = search_results([tmp_path])
    assert [r.folder.parent.name for r in found.results] == ["runs", "now"]
    (skipped,) = found.skipped
    assert skipped.folder == tmp_path / "runs" / "old" / "leaderboard"
    (tmp_path / "plan.json").write_text("{damaged")  # says nothing of any run
    assert not search_results([tmp_path]).skipped


def test_reference_policies_of_an_earlier_plan_are_skipped(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    for name in ("noop-MakeLine", "random-MakeLine"):
        write_entry(f"references/{name}", name, LINE)
    write_plan(tmp_path)
    assert not search_results([tmp_path]).skipped  # plans of earlier versions do not name them
    write_json(tmp_path / "plan.json", {"runs": [], "references": ["noop-MakeLine"]})
    (skipped,) = search_results([tmp_path]).skipped
    assert skipped.folder.name == "random-MakeLine"
