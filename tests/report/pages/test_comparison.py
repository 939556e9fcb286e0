"""Two methods held against each other."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from magical import cli
from magical.errors import UnknownNameError
from magical.report.found.search import Result, find_results
from magical.report.pages.comparison import ComparisonPage, compare
from magical.report.scores.tables import TextTable
from tests.report.conftest import WriteEntry


@pytest.fixture
def results(write_entry: WriteEntry, tmp_path: Path) -> Path:
    for seed, (a, b) in enumerate([(0.9, 0.3), (0.8, 0.2), (0.7, 0.1)]):
        for method, score, count in (("a", a, 10), ("b", b, 25)):
            scores = {"MakeLine-Demo": [score], "MakeLine-TestAll": [score - 0.1]}
            write_entry(f"{method}{seed}", method, scores, seed, details={"demonstrations": count})
    write_entry("c", "c", {"FindDupe-Demo": [1.0]})
    return tmp_path


def by_title(page: ComparisonPage) -> dict[str, TextTable]:
    return {table.title: table for table in page.tables}


def test_differences_are_those_of_the_statistics(results: Path) -> None:
    found = compare(find_results([results]).results, "a", "b")
    # Both have the standard deviation 0.1 over three runs, so 4 degrees of freedom.
    half = 2.776445 * (2 * 0.01 / 3) ** 0.5
    assert found.overall["all"] == pytest.approx((0.6, 0.6 - half, 0.6 + half))
    assert list(found.overall) == ["all", "MakeLine", "Demo", "All (variant)"]
    assert found.overall["Demo"].value == pytest.approx(0.6)
    assert "0.60 higher" in found.headline
    assert "does not show" not in found.headline
    environments = by_title(found)["Environment by environment"]
    assert environments.rows[1][:2] == ("MakeLine", "All")
    assert environments.rows[1][2:] == (
        "0.70 [0.45, 0.95]",
        "0.10 [0.00, 0.35]",
        "+0.60 [+0.37, +0.83]",
    )


def test_settings_that_differ_are_shown(results: Path) -> None:
    settings = by_title(compare(find_results([results]).results, "a", "b"))["Settings that differ"]
    assert settings.rows == [("demonstrations", "10", "25")]


def test_an_interval_around_0_is_said_to_show_nothing(results: Path) -> None:
    found = find_results([results]).results
    same = [
        Result(result.folder, replace(result.entry, method="copy"))
        for result in found
        if result.entry.method == "a"
    ]
    assert "does not show" in compare([*same, *found], "a", "copy").headline


def test_unknown_methods_and_nothing_in_common_are_refused(results: Path) -> None:
    found = find_results([results]).results
    with pytest.raises(UnknownNameError, match="expected one of: a, b, c"):
        compare(found, "a", "d")
    with pytest.raises(UnknownNameError, match="environment in common"):
        compare(found, "a", "c")
    with pytest.raises(UnknownNameError, match="two different methods, found 'a' twice"):
        compare(found, "a", "a")


def test_the_command_writes_a_page(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("jinja2", reason="the report extra is not installed")
    pytest.importorskip("matplotlib", reason="the report extra is not installed")
    page = results / "compare.html"
    argv = ["report", str(results), "--compare", "a", "b", "--out", str(page)]
    assert cli.main(argv) == 0
    assert "+0.60 [+0.37, +0.83]" in capsys.readouterr().out
    text = page.read_text()
    assert "<h1>a and b</h1>" in text
    ids = re.findall(r' id="([^"]+)"', text)
    assert len(ids) == len(set(ids)) > 10
    assert cli.main(["report", str(results), "--compare", "a", "d"]) == 2
    assert "expected one of: a, b, c" in capsys.readouterr().err
    assert cli.main([*argv[:-1], str(results / "compare.csv")]) == 2
    assert not (results / "compare.csv").exists()
