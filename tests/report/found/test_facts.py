"""How every run was made."""

from pathlib import Path

from magical.report.found.facts import describe_methods
from magical.report.found.search import find_results
from tests.report.conftest import WriteEntry

LINE = {"MakeLine-Demo": [1.0]}


def test_what_runs_have_in_common_is_said_once(write_entry: WriteEntry, tmp_path: Path) -> None:
    for seed in (0, 1):
        details = {"authors": ["A", "B"], "note": f"n{seed}"}
        write_entry(f"m/{seed}", "m", LINE, seed, details=details, version="0.1.0")
    page = tmp_path / "page.html"
    (method,) = describe_methods(find_results([tmp_path / "m"]).results, page)
    assert method.common["authors"] == "A, B"
    assert method.common["recorded: versions: torch"] == "9.9"
    assert method.common["evaluated by version"] == "0.1.0"
    assert [run.facts for run in method.runs] == [
        {"note": "n0", "training: seed": "0"},
        {"note": "n1", "training: seed": "1"},
    ]
    assert method.runs[0].links == {
        "scores.csv": "m/0/scores.csv",
        "entry.json": "m/0/entry.json",
        "config.json": "m/0/config.json",
        "run.json": "m/0/run.json",
    }


def test_describing_a_run_twice_says_the_same(write_entry: WriteEntry, tmp_path: Path) -> None:
    folder = write_entry("m", "m", LINE, seed=0)
    (folder / "run.json").write_text('{"demonstrations": ["a", "b"]}')
    (folder / "result.json").write_text('{"commit": "abc", "settings": {"augment": "all"}}')
    results = find_results([tmp_path]).results
    first, second = describe_methods(results), describe_methods(results)
    assert first[0].common["demonstrations used"] == "2"
    assert first[0].common["recorded: commit"] == "abc"
    assert second == first


def test_links_are_addresses_relative_to_the_page(write_entry: WriteEntry, tmp_path: Path) -> None:
    write_entry("a #1", "m", LINE)
    (method,) = describe_methods(find_results([tmp_path]).results, tmp_path / "site" / "page.html")
    assert method.runs[0].links["scores.csv"] == "../a%20%231/scores.csv"
