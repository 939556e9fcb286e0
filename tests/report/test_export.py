"""Tables as CSV and Markdown."""

import csv
from pathlib import Path

import pytest

from magical import cli
from magical.errors import UnknownNameError
from magical.evaluation import published_score
from magical.report.page import format_of, markdown
from magical.report.table import TextTable
from tests.report.conftest import WriteEntry

BC = "BC (ST)"


@pytest.fixture
def results(write_entry: WriteEntry, tmp_path: Path) -> Path:
    write_entry("in/bc0", BC, {"FindDupe-Demo": [1.0, 0.6], "FindDupe-TestAll": [0.5, 0.5]})
    write_entry("in/bc1", BC, {"FindDupe-Demo": [0.6, 0.2], "FindDupe-TestAll": [0.1, 0.1]})
    write_entry("in/odd", "50% & $x_1$ | ~", {"FindDupe-Demo": [0.0], "FindDupe-TestAll": [0.0]})
    return tmp_path / "in"


def test_csv_has_every_number(results: Path, tmp_path: Path) -> None:
    out = tmp_path / "table.csv"
    assert cli.main(["report", str(results), "--out", str(out)]) == 0
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:6] == ["task", "variant", "method", "runs", "interval_over", "score"]
    demo = rows[0]
    published = published_score("FindDupe", BC, "Demo")
    assert published is not None
    assert (demo["task"], demo["variant"], demo["method"]) == ("FindDupe", "Demo", BC)
    assert (demo["runs"], demo["interval_over"]) == ("2", "rollouts")
    assert float(demo["score"]) == pytest.approx(0.6)
    assert float(demo["score_std"]) == pytest.approx(0.2)
    assert float(demo["published_code_score"]) == pytest.approx(0.3)
    assert float(demo["published"]) == published.mean
    assert float(demo["difference"]) == pytest.approx(0.3 - published.mean, abs=1e-5)
    odd = rows[-1]
    assert (odd["runs"], odd["interval_over"], odd["score_std"]) == ("1", "rollouts", "")
    assert (odd["published"], odd["difference"]) == ("", "")


@pytest.mark.parametrize("first", ["=", "+", "-", "@"])
def test_names_are_no_formulas_of_a_spreadsheet(
    first: str, write_entry: WriteEntry, tmp_path: Path
) -> None:
    name = f"{first}HYPERLINK(1)"
    write_entry("in/one", name, {"FindDupe-Demo": [0.0, 0.5]})
    out = tmp_path / "table.csv"
    assert cli.main(["report", str(tmp_path / "in"), "--out", str(out)]) == 0
    with out.open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["method"], row["score"]) == (f"'{name}", "0.25")


def test_csv_has_test_evaluations_and_track(write_entry: WriteEntry, tmp_path: Path) -> None:
    record = {"learned_from": ["demonstrations", "simulator"], "test_evaluations": 3}
    folder = write_entry("run", "m", {"MakeLine-Demo": [1.0]}, record=record)
    out = tmp_path / "table.csv"
    assert cli.main(["report", str(folder), "--out", str(out)]) == 0
    (row,) = csv.DictReader(out.read_text().splitlines())
    assert (row["method"], row["track"], row["test_evaluations"]) == ("m", "X", "3")


def test_scores_with_another_horizon_stand_beside_no_published_ones(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_entry("in/a", BC, {"FindDupe-Demo": [1.0, 0.0]}, horizon="400")
    out = tmp_path / "table.csv"
    assert cli.main(["report", str(tmp_path / "in"), "--out", str(out)]) == 0
    (row,) = csv.DictReader(out.read_text().splitlines())
    assert (row["published"], row["published_std"]) == ("", "")


def test_markdown_cells_are_escaped(results: Path, tmp_path: Path) -> None:
    out = tmp_path / "table.md"
    cli.main(["report", str(results), "--out", str(out)])
    text = out.read_text()
    named = tmp_path / "table.txt"
    cli.main(["report", str(results), "--out", str(named), "--format", "markdown"])
    assert named.read_text() == text
    assert "## FindDupe, beside the published scores" in text
    assert r"50% & $x\_1$ \| ~" in text
    lines = [line for line in text.splitlines() if line.startswith("| FindDupe")]
    assert {line.count("|") for line in lines} == {lines[0].count("|")}


def test_tables_are_escaped() -> None:
    table = TextTable("T", ("a", "b"), [("x", "0.50 [0.40, 0.60]")], "note")
    assert markdown(table).splitlines()[2:5] == [
        "| a | b |",
        "| --- | --- |",
        r"| x | 0.50 \[0.40, 0.60\] |",
    ]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("x.csv", "csv"), ("x.MD", "markdown"), ("x.html", "html"), ("x", "html")],
)
def test_the_suffix_says_the_format(name: str, kind: str) -> None:
    assert format_of(Path(name)) == kind


def test_another_suffix_is_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"x\.pdf: expected the suffix .*, or --format"):
        format_of(Path("x.pdf"))
