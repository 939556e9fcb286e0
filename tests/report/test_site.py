"""The leaderboard's pages."""

import json
import re
import shutil
from pathlib import Path

import pytest

from magical import cli
from magical.errors import SiteError
from magical.evaluation.protocol import ROLLOUTS
from magical.report.leaderboard import make_leaderboard
from magical.tasks import get_task
from tests.report.conftest import WriteEntry

pytest.importorskip("jinja2", reason="the report extra is not installed")
pytest.importorskip("matplotlib", reason="the report extra is not installed")


@pytest.fixture
def entries(write_entry: WriteEntry, tmp_path: Path) -> Path:
    scores = {f"MoveToRegion-{v}": [0.5] * ROLLOUTS for v in get_task("MoveToRegion").variants}
    right = {
        "observation": "LoRes4E",
        "nudge": 1e-9,
        "record": {
            "learned_from": ["demonstrations"],
            "demonstrations": "<5>",
            "test_evaluations": 0,
        },
    }
    write_entry("in/a", "<A> & b", scores, 0, **right)
    better = {name: [1.0] * ROLLOUTS for name in scores}
    write_entry("in/c", "C", better, **right | {"record": {"learned_from": []}})
    write_entry("in/old", "old", scores, **right | {"version": "0.0.1"})
    (write_entry("in/bad", "bad", scores, **right) / "entry.json").write_text("{")
    return tmp_path / "in"


def test_the_site_is_whole(
    entries: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = tmp_path / "site"
    assert cli.main(["leaderboard", str(entries), "--out", str(site)]) == 0
    printed = capsys.readouterr().out
    assert "no method has entries on all tasks" in printed
    assert "All tasks" not in printed
    assert printed.index("C ") < printed.index("<A> & b")
    assert "not ranked: " in printed
    assert "made by version 0.0.1" in printed
    text = (site / "index.html").read_text()
    assert "&lt;A&gt; &amp; b" in text
    assert "No method has entries on all tasks." in text
    assert "expected JSON" in text
    assert 'data-used="demonstrations"' in text
    stated = re.findall('<td>([^<]*)</td><td class="words">([^<]*)</td><td>([^<]*)</td>', text)
    assert stated == [("–", "–", "–"), ("P", "&lt;5&gt;", "0")]
    assert re.search(r"<A> & b .* P +demonstrations", printed)
    for page in site.rglob("*.html"):
        found = re.findall(r'(?:src|href)="([^"]+)"', page.read_text())
        assert found
        for address in found:
            assert not address.startswith(("http", "//"))
            if not address.startswith(("#", "data:")):
                target = (page.parent / address).resolve()
                assert target.is_file()
                assert target.is_relative_to(site.resolve())


def test_the_boards_are_given_as_json(entries: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["leaderboard", str(entries), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["boards"]["All tasks"] == []
    first, second = found["boards"]["MoveToRegion"]
    assert (first["method"], first["rank"], first["test_all"][0]) == ("C", 1, 1.0)
    assert (second["rank"], second["rank_by_gap"]) == (None, None)  # one run that learned
    assert second["used"] == ["demonstrations"]
    assert (second["track"], second["test_evaluations"]) == ("P", 0)
    assert len(found["rejected"]) == 2


def test_entries_that_are_not_ranked_stand_together_by_reason(
    entries: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(20):
        shutil.copytree(entries / "old", entries / f"old{number}")
    site = tmp_path / "site"
    assert cli.main(["leaderboard", str(entries), "--out", str(site)]) == 0
    assert "old and 20 more: made by version 0.0.1" in capsys.readouterr().out
    text = (site / "index.html").read_text()
    assert "<details><summary>21 entries: made by version 0.0.1" in text
    assert f"<li>{entries / 'old7'} (old)</li>" in text


def test_the_page_explains_its_words_and_says_what_was_run_again(
    entries: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = tmp_path / "site"
    argv = ["leaderboard", str(entries), "--out", str(site), "--rerun"]
    assert cli.main([*argv, "C"]) == 0
    text = (site / "index.html").read_text()
    for word in ("nudge", "track", "test evaluations, †", "gap", "reference"):
        assert f"<dt>{word}</dt>" in text
    assert "Scores are as submitted, unless marked" in text
    assert text.count("<small>rerun</small>") == 1
    assert cli.main([*argv, "old"]) == 2
    assert "expected ranked methods to mark as rerun, found ['old']" in capsys.readouterr().err


@pytest.mark.parametrize("folder", ["site", "."])
def test_the_site_may_lie_among_the_entries(entries: Path, folder: str) -> None:
    site = entries / folder
    argv = ["leaderboard", str(entries), "--out", str(site)]
    assert cli.main(argv) == 0
    first = (site / "index.html").read_text()
    assert cli.main(argv) == 0
    assert (site / "index.html").read_text() == first


def test_without_a_valid_entry_the_page_says_why(
    write_entry: WriteEntry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_entry("in", "m", {"MoveToRegion-Demo": [1.0]})
    site = tmp_path / "site"
    assert cli.main(["leaderboard", str(folder), "--out", str(site)]) == 0
    assert "1 rollouts of each environment, expected 100" in capsys.readouterr().out
    assert "all variants of a task are needed" in (site / "index.html").read_text()
    assert cli.main(["leaderboard", str(tmp_path / "missing")]) == 1
    assert f"{tmp_path / 'missing'}: expected a folder" in capsys.readouterr().err


def test_what_is_no_longer_ranked_is_removed(entries: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    make_leaderboard([entries]).write(site)
    assert len(list((site / "methods").iterdir())) == 2
    shutil.rmtree(entries / "a")
    make_leaderboard([entries]).write(site)
    assert [path.name for path in (site / "methods").iterdir()] == ["001-c.html"]


def test_a_page_of_something_else_is_not_overwritten(entries: Path, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(SiteError, match=r"expected no pages or a leaderboard's"):
        make_leaderboard([entries]).write(tmp_path)
    assert (tmp_path / "index.html").read_text() == "mine"
    mine = tmp_path / "site" / "methods" / "001-mine"
    mine.mkdir(parents=True)
    with pytest.raises(SiteError, match=r"expected no pages or a leaderboard's"):
        make_leaderboard([entries]).write(tmp_path / "site")
    assert mine.is_dir()
