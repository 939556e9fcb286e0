"""The main job, with little of everything."""

import re
from pathlib import Path

import pytest

from magical import cli
from magical.evaluation import read_entry

for _extra in ("torch", "safetensors", "jinja2", "matplotlib"):
    pytest.importorskip(_extra, reason="the learning and report extras are not installed")

TASK = "MoveToRegion"  # the quickest
ARGV = ["quickstart", "--task", TASK, "--rollouts", "2", "--batches", "3", "--workers", "0"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("quickstart")
    assert cli.main([*ARGV, "--out", str(path)]) == 0
    return path


def test_the_page_shows_all_parts(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    for word in (
        "BC quick",
        "scripted expert",
        "random policy",
        "BC (ST), published",
        "Learning curves",
        "BC quick on MoveToRegion",
    ):
        assert word in text
    assert len(re.findall("data:image/webp", text)) == 6
    assert not re.findall(r'(?:src|href)="(?!data:|#)', text)


def test_everything_is_kept(folder: Path) -> None:
    assert (folder / "contact-sheet.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / f"bc-{TASK}" / "checkpoint.safetensors").is_file()
    entry = read_entry(folder / "evaluation" / f"scripted-expert-{TASK}")
    assert entry.privileged
    assert {row.env_id.split("/")[1].split("-")[0] for row in entry.scores} == {TASK}


def test_a_second_quickstart_takes_up_what_is_there(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (folder / "bc-MoveToRegion" / "metrics.jsonl").read_bytes()
    assert cli.main([*ARGV, "--out", str(folder)]) == 0
    assert (folder / "bc-MoveToRegion" / "metrics.jsonl").read_bytes() == before
    out = capsys.readouterr().out
    assert "BC (ST), published" in out
    assert "MoveToCorner" not in out
    assert f"report: {folder / 'report.html'}" in out


def test_another_seed_in_the_same_folder_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*ARGV, "--out", str(folder), "--seed", "1"]) == 1
    assert "expected demonstrations generated with seed 1, found one of" in capsys.readouterr().err
