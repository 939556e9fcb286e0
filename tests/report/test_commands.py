"""`magical report` in all its formats; what is checked before the work, and failures."""

import csv
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from magical import cli, extras
from magical.evaluation import published_score
from tests.report.conftest import WriteEntry

BC = "BC (ST)"
VOID = {"meta", "img", "br", "link", "input"}


class Balanced(HTMLParser):
    """Fails where an element is closed that is not open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open += [tag] * (tag not in VOID)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture
def page(tmp_path: Path) -> Path:
    pytest.importorskip("jinja2", reason="the report extra is not installed")
    pytest.importorskip("matplotlib", reason="the report extra is not installed")
    return tmp_path / "page.html"


@pytest.fixture
def results(write_entry: WriteEntry, tmp_path: Path) -> Path:
    record = {"learned_from": ["demonstrations", "simulator"], "test_evaluations": 3}
    write_entry("in/bc0", BC, {"FindDupe-Demo": [1.0, 0.6], "FindDupe-TestAll": [0.5, 0.5]})
    write_entry("in/bc1", BC, {"FindDupe-Demo": [0.6, 0.2], "FindDupe-TestAll": [0.1, 0.1]})
    write_entry("in/odd", "=50% & $x_1$ | ~", {"FindDupe-Demo": [0.0, 0.5]}, record=record)
    return tmp_path / "in"


def test_csv_has_every_number(results: Path, tmp_path: Path) -> None:
    out = tmp_path / "table.csv"
    assert cli.main(["report", str(results), "--out", str(out)]) == 0
    with out.open(newline="") as file:
        demo, _, odd = csv.DictReader(file)
    published = published_score("FindDupe", BC, "Demo")
    assert published is not None
    assert list(demo)[:6] == ["task", "variant", "method", "runs", "interval_over", "score"]
    assert list(demo.values())[:5] == ["FindDupe", "Demo", BC, "2", "rollouts"]
    assert {key: float(demo[key]) for key in list(demo)[5:7]} == {"score": 0.6, "score_std": 0.2}
    assert float(demo["published_code_score"]) == pytest.approx(0.3)
    assert float(demo["published"]) == published.mean
    assert float(demo["difference"]) == pytest.approx(0.3 - published.mean, abs=1e-5)
    how = ("horizon", "rollouts", "seed", "nudge", "action_space", "privileged")
    assert [demo[key] for key in how] == ["100", "2", "0", "0", "discrete", "False"]
    assert odd["method"] == "'=50% & $x_1$ | ~"  # not a formula of a spreadsheet
    assert (odd["runs"], odd["score"], odd["score_std"]) == ("1", "0.25", "")
    assert (odd["published"], odd["difference"]) == ("", "")
    assert (odd["track"], odd["test_evaluations"]) == ("X", "3")


def test_markdown_is_escaped(results: Path, tmp_path: Path) -> None:
    out, named = tmp_path / "table.md", tmp_path / "table.txt"
    assert cli.main(["report", str(results), "--out", str(out)]) == 0
    text = out.read_text()
    assert cli.main(["report", str(results), "--out", str(named), "--format", "markdown"]) == 0
    assert named.read_text() == text
    assert "## FindDupe, beside the published scores" in text
    assert r"=50% & $x\_1$ \| ~" in text
    assert re.search(r"\\\[0\.\d+, 0\.\d+\\\]", text)
    lines = [line for line in text.splitlines() if line.startswith("| FindDupe")]
    assert {line.count("|") for line in lines} == {lines[0].count("|")}


def test_the_last_line_is_json(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / "entry.json").write_text("{}")
    assert cli.main(["report", str(results), str(damaged), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [skipped["folder"] for skipped in printed["skipped"]] == [str(damaged)]
    *_, odd = printed["rows"]
    assert (odd["variant"], odd["score"], odd["score_std"]) == ("Demo", 0.25, None)
    assert odd["score_low"] < 0.25 < odd["score_high"]


def test_following_the_advice_shows_the_published_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    advice = "evaluate with --horizon published to compare"
    argv = ["evaluate", "noop", "--task", "ClusterColour", "--rollouts", "2", "--workers", "0"]
    argv += ["--variants", "Demo", "--method", BC, "--out"]
    report = ["report", str(tmp_path)]
    assert cli.main([*argv, str(tmp_path / "a")]) == 0
    assert cli.main(report) == 0
    assert advice in capsys.readouterr().out
    assert cli.main([*argv, str(tmp_path / "b"), "--horizon", "published"]) == 0
    capsys.readouterr()
    assert cli.main(report) == 0
    out, err = capsys.readouterr()
    assert "skipped" not in err
    assert advice not in out
    lines = [line.split("  ")[0] for line in out.splitlines() if line.startswith(BC)]
    assert lines[:2] == [BC, f"{BC}, horizon 240"]  # by the appendix's rule
    assert lines[2:4] == [f"{BC}, horizon 240", f"{BC}, published"]


def test_a_page_is_one_file_that_says_everything(
    write_entry: WriteEntry, tmp_path: Path, page: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scores = {"MoveToRegion-Demo": [1.0, 0.0], "MoveToRegion-TestAll": [0.0, 0.0]}
    for seed in (0, 1):
        folder = write_entry(f"runs/a{seed}", "<a>", scores, seed, record={"policy": "."})
        rows = [json.dumps({"step": step, "loss": 1 / (step + 1)}) for step in range(20)]
        (folder / "metrics.jsonl").write_text("\n".join(rows) + '\n{"step": 21, "loss": null}\n')
    write_entry("runs/b", "$b_1日本", scores, record={"policy": "noop"})
    (write_entry("runs/\x1b[2J", "bad", scores) / "scores.csv").write_text("bad")
    (folder / "metrics.jsonl").write_text("[" * 100_000 + "\n")
    argv = ["report", str(tmp_path / "runs"), "--out", str(page), "--clips", "2"]
    assert cli.main(argv) == 0
    error = capsys.readouterr().err
    assert "skipped" in error
    assert "\x1b" not in error
    text = page.read_text()
    cli.main(argv)
    assert page.read_text() == text
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    addresses = re.findall(r'\b(?:src|href)="([^"]*)"', text)
    assert not [address for address in addresses if address.startswith(("http", "//"))]
    assert any(address.startswith("data:image/webp") for address in addresses)
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(#|href="#)([^")]+)', text)) <= set(ids)
    for words in (
        "3 evaluated runs of 2 methods; 2 skipped",
        '<td style="background:rgb(144,178,214);color:#222">0.50<small>',
        "expected the header",
        "expected JSON",
        "Generalisation gaps",
        'aria-label="Learning curves: loss on MoveToRegion"',
        "$b_1日本 on MoveToRegion",
        "&lt;a&gt; on MoveToRegion: ",  # its run folder has no checkpoint
    ):
        assert words in text, words


def test_empty_parts_of_a_page_are_left_out_and_clips_of_nothing_are_an_error(
    write_entry: WriteEntry, tmp_path: Path, page: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_entry("a", "mine", {"MakeLine-Demo": [1.0] * 3})
    argv = ["report", str(folder), "--out", str(page)]
    assert cli.main([*argv, "--published", BC]) == 0
    assert "0.48 ± 0.08" in capsys.readouterr().out
    text = page.read_text()
    assert "BC (ST), published" in text
    for heading in ("Learning curves", "rollouts</h2>", "Generalisation gaps"):
        assert heading not in text
    assert cli.main([*argv, "--clips", "2"]) == 1
    error = capsys.readouterr().err
    assert "error: no rollouts of mine on MakeLine: " in error
    assert "expected a run folder or one of" in error


@pytest.mark.parametrize(
    ("argv", "status", "message"),
    [
        (["none"], 1, "none: expected a folder with scores.csv"),
        (["in", "--out", "."], 2, "expected a file, found the folder"),
        (["in", "--out", "x.pdf"], 2, "x.pdf: expected the suffix"),
        (["in", "--out", "x.csv", "--clips", "2"], 2, "--clips needs a page"),
        (["in", "--published", "BC"], 2, "BC (ST)"),
    ],
)
def test_what_cannot_be_done_is_said(
    argv: list[str],
    status: int,
    message: str,
    results: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(results.parent)
    assert cli.main(["report", *argv]) == status
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "argv", [["report", "a", "--out", "page.html"], ["leaderboard", "a", "--out", "site"]]
)
def test_missing_libraries_are_named_before_the_work(
    argv: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)  # there is no folder `a`: that would be found first
    monkeypatch.setattr(extras, "find_spec", lambda module: None if module == "jinja2" else 1)
    assert cli.main(argv) == 1
    assert "this needs jinja2, which is not installed" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
