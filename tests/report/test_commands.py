"""`magical report` and `leaderboard`: what is checked before the work, and failures."""

import json
from pathlib import Path

import pytest

from magical import cli, extras
from tests.report.conftest import WriteEntry


def test_clips_of_nothing_are_an_error(
    write_entry: WriteEntry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("jinja2", reason="the report extra is not installed")
    pytest.importorskip("matplotlib", reason="the report extra is not installed")
    folder = write_entry("a", "mine", {"MoveToRegion-Demo": [1.0]})
    page = tmp_path / "page.html"
    argv = ["report", str(folder), "--clips", "2", "--out"]
    assert cli.main([*argv, str(page)]) == 1
    error = capsys.readouterr().err
    assert "error: no rollouts of mine on MoveToRegion: " in error
    assert "expected a run folder or one of" in error
    assert "mine on MoveToRegion" in page.read_text()
    assert cli.main([*argv, str(tmp_path / "page.csv")]) == 2
    assert "--clips needs a page" in capsys.readouterr().err
    policy = {"policy": "noop"}
    folder = write_entry("b", "noop", {"MoveToRegion-Demo": [0.0]}, record=policy)
    assert cli.main(["report", str(folder), "--clips", "2", "--out", str(page)]) == 0


def test_the_last_line_is_json(
    write_entry: WriteEntry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [
        str(write_entry(method, method, {"MoveToRegion-Demo": scores}))
        for method, scores in (("mine", [1.0, 0.0]), ("other", [0.0, 0.0]))
    ]
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "entry.json").write_text("{}")
    damaged = str(tmp_path / "damaged")
    assert cli.main(["report", *runs, damaged, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [skipped["folder"] for skipped in printed["skipped"]] == [damaged]
    mine, other = printed["rows"]
    assert (mine["method"], mine["variant"], mine["score"]) == ("mine", "Demo", 0.5)
    assert mine["score_low"] < 0.5 < mine["score_high"]
    assert mine["score_std"] is None
    assert other["score"] == 0.0


@pytest.mark.parametrize(
    "argv",
    [
        ["report", "a", "--out", "page.html"],
        ["leaderboard", "a", "--out", "site"],
    ],
)
def test_missing_libraries_are_named_before_the_work(
    argv: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)  # there is no folder `a`: that would be found first
    monkeypatch.setattr(extras, "_is_installed", lambda module: module != "jinja2")
    assert cli.main(argv) == 1
    assert "this needs jinja2, which is not installed" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
