"""Evaluated runs in folders, and what is missing among them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from magical.errors import ScoresError
from magical.report.folders import evaluated_page
from magical.report.missing import find_missing
from magical.report.results import find_results, search_results

WriteEntry = Callable[..., Path]
LINE = {"MakeLine-Demo": [1.0, 0.0]}


def write_json(path: Path, data: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data))


def test_entries_are_found_at_any_depth_in_order(write_entry: WriteEntry, tmp_path: Path) -> None:
    for name in ("b/run", "a", "b/other/deep", "b/.hidden"):
        write_entry(name, name, LINE)
    found = find_results([tmp_path]).found
    assert [result.entry.method for result in found] == ["a", "b/other/deep", "b/run"]
    again = find_results([tmp_path / "b", tmp_path]).found
    assert [result.entry.method for result in again] == ["b/other/deep", "b/run", "a"]


def test_an_entry_belongs_to_the_run_beside_or_around_it(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_entry("own", "own", LINE, seed=1)
    write_entry("around/evaluation", "around", LINE)
    write_json(tmp_path / "around" / "config.json", {"seed": 2, "tasks": ["MakeLine"]})
    write_entry("inside", "inside", LINE)
    write_json(tmp_path / "inside" / "run" / "config.json", {"seed": 3, "tasks": ["MakeLine"]})
    write_entry("alone", "alone", LINE, details={"training_seed": 4})
    results = find_results([tmp_path])
    assert {r.entry.method: r.seed for r in results.found} == {
        "own": 1,
        "around": 2,
        "inside": 3,
        "alone": 4,
    }
    assert results.not_evaluated == []


def test_damaged_entries_are_skipped_by_name(write_entry: WriteEntry, tmp_path: Path) -> None:
    write_entry("good", "good", LINE)
    (write_entry("bad", "bad", LINE) / "scores.csv").write_text("nothing")
    (write_entry("deep", "deep", LINE) / "entry.json").write_text("[" * 100_000)
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "entry.json").write_text("{}")
    results = find_results([tmp_path])
    assert [result.entry.method for result in results.found] == ["good"]
    assert [item.folder.name for item in results.skipped] == ["bad", "deep", "half"]
    assert "expected the header" in results.skipped[0].reason
    assert "no scores.csv" in results.skipped[2].reason


def test_nothing_but_damaged_entries_is_an_error(write_entry: WriteEntry, tmp_path: Path) -> None:
    (write_entry("bad", "bad", LINE) / "scores.csv").write_text("nothing")
    with pytest.raises(ScoresError, match="expected the header"):
        find_results([tmp_path])
    with pytest.raises(ScoresError, match=r"found no scores\.csv"):
        find_results([tmp_path / "missing"])


def test_missing_tasks_runs_seeds_and_variants_are_named(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    region = {f"MoveToRegion-{v}": [1.0] for v in ("Demo", "TestJitter", "TestLayout")}
    rest = {f"MoveToRegion-{v}": [1.0] for v in ("TestColour", "TestDynamics", "TestAll")}
    write_entry("a0", "a", region | rest, seed=0)
    write_entry("a1", "a", region, seed=1)
    write_entry("b0", "b", region | rest, seed=0)
    write_entry("c0", "c", {"MakeLine-Demo": [1.0]}, seed=0)
    write_entry("c1", "c", {"MakeLine-Demo": [0.5]}, seed=1)
    write_json(tmp_path / "d0" / "config.json", {"seed": 0})
    missing = {(m.method, m.task, m.what) for m in find_missing(find_results([tmp_path]))}
    variants = "Jitter, Layout, Colour, Shape, CountPlus, Dynamics, All"
    assert missing == {
        ("a", "MoveToRegion", "seed 1: not evaluated on Colour, Dynamics, All"),
        ("b", "MoveToRegion", "1 of 2 runs: no seed 1"),
        ("c", "MoveToRegion", "no run"),
        ("a", "MakeLine", "no run"),
        ("b", "MakeLine", "no run"),
        ("c", "MakeLine", f"seeds 0, 1: not evaluated on {variants}"),
        ("–", "–", f"{tmp_path / 'd0'}: a training run without an entry"),
    }


def test_a_plan_says_which_runs_are_missing(write_entry: WriteEntry, tmp_path: Path) -> None:
    region = {
        f"MoveToRegion-{v}": [1.0]
        for v in ("Demo", "TestJitter", "TestLayout", "TestColour", "TestDynamics", "TestAll")
    }
    write_entry("runs/done", "a", region, seed=0)
    write_json(tmp_path / "runs" / "failed" / "config.json", {"seed": 1})
    write_json(tmp_path / "runs" / "failed" / "result.json", {"state": "failed", "error": "oh"})
    write_json(tmp_path / "runs" / "begun" / "config.json", {"seed": 2})
    run = {"method": "a", "tasks": ["MoveToRegion"]}
    names = ("done", "failed", "begun", "waiting")
    runs = [{**run, "folder": name, "seed": seed} for seed, name in enumerate(names)]
    write_json(tmp_path / "plan.json", {"runs": [*runs, {"folder": 7}, "nothing"]})
    write_entry("runs/earlier", "a", region, seed=9)
    results = find_results([tmp_path])
    assert [result.folder.name for result in results.found] == ["done"]
    assert [item.folder.name for item in results.skipped] == ["earlier"]
    missing = [(m.method, m.task, m.what) for m in find_missing(results)]
    assert missing == [
        ("a", "MoveToRegion", "seed 1: failed: oh"),
        ("a", "MoveToRegion", "seed 2: not finished"),
        ("a", "MoveToRegion", "seed 3: not run"),
    ]


def test_a_training_run_counts_once_in_a_row(write_entry: WriteEntry, tmp_path: Path) -> None:
    write_entry("a", "bc", LINE, seed=0)
    write_entry("another-set-of-seeds", "bc", {"MakeLine-Demo": [0.0, 0.0]}, seed=0)
    write_entry("b", "bc", LINE, seed=1)  # equal scores, another run
    write_entry("nudged", "bc", LINE, seed=0, nudge=1e-9)  # another row
    write_entry("third", "mine", LINE)
    write_entry("third-copy", "mine", LINE)
    results = find_results([tmp_path])
    assert [r.folder.name for r in results.found] == ["a", "b", "nudged", "third"]
    assert [item.folder.name for item in results.skipped] == ["another-set-of-seeds", "third-copy"]
    assert results.skipped[0].reason.endswith("a: each run counts once in a row")


def test_runs_of_other_settings_are_other_runs(write_entry: WriteEntry, tmp_path: Path) -> None:
    for name in ("a", "b"):
        folder = write_entry(name, "bc", LINE, seed=0)
        write_json(folder / "config.json", {"seed": 0, "tasks": ["MakeLine"], "augment": name})
    assert len(find_results([tmp_path]).found) == 2


def test_a_policy_in_the_package_has_no_training_run(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_entry("par", "random", LINE, details={"policy": "random"})
    write_entry("par/bc", "bc", LINE, seed=7)
    found = {result.entry.method: result for result in find_results([tmp_path]).found}
    assert (found["random"].run, found["random"].seed) == (None, None)
    assert found["bc"].seed == 7


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"demonstrations": 5}', '{"steps": ' + "9" * 400 + "}", '"\\ud800"']
)
def test_a_damaged_record_of_a_run_does_not_stop_a_page(
    write_entry: WriteEntry, tmp_path: Path, text: str
) -> None:
    folder = write_entry("a", "bc", LINE, seed=1, details={"authors": "\ud800"})
    for name in ("run.json", "result.json", "metrics.jsonl"):
        (folder / name).write_text(text + "\n")
    site = tmp_path / "page.html"
    evaluated_page("a", find_results([tmp_path]), out=site).write(site)
    assert "bc" in site.read_text("utf-8")


def test_entries_inside_a_run_that_is_no_longer_the_plans_are_skipped(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    for name in ("runs/old/leaderboard", "runs/now/leaderboard", "runs/now"):
        write_entry(name, "bc", LINE)
    plan = {"folder": "now", "method": "bc", "tasks": ["MakeLine"], "seed": 0}
    write_json(tmp_path / "plan.json", {"runs": [plan]})
    results = search_results([tmp_path])
    assert [r.folder.parent.name for r in results.found] == ["runs", "now"]
    (skipped,) = results.skipped
    assert skipped.folder == tmp_path / "runs" / "old" / "leaderboard"
