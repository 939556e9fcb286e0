"""The main job, with little of everything."""

import json
import re
from pathlib import Path

import pytest

from magical import cli
from magical.evaluation import read_entry
from magical.experiments.plan import find_plan, read_plan
from magical.runs.sources import learned_from

for _extra in ("torch", "safetensors", "jinja2", "matplotlib"):
    pytest.importorskip(_extra, reason="the learning and report extras are not installed")

TASK = "MoveToRegion"  # the quickest
ARGV = ["quickstart", "--task", TASK, "--rollouts", "2", "--batches", "3", "--workers", "1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("quickstart")
    assert cli.main([*ARGV, "--out", str(path)]) == 0
    return path


def test_the_page_shows_all_parts(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    for word in ("expert", "random", "BC (ST), published", "BC quick on MoveToRegion", "<svg"):
        assert word in text
    assert len(re.findall("data:image/webp", text)) >= 6


def test_entries_say_what_was_learned_from_and_are_verified(folder: Path) -> None:
    (run,) = (folder / "runs").iterdir()
    expert = folder / "references" / f"expert-{TASK}"
    assert learned_from(read_entry(run).details) == ("demonstrations",)
    assert learned_from(read_entry(expert).details) == ()
    assert read_entry(expert).privileged
    assert (run / "checkpoint.safetensors").is_file()
    for entry in (run, expert):
        assert cli.main(["verify", str(entry), "--workers", "0"]) == 0


def test_a_second_quickstart_takes_up_what_is_there(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [*folder.glob("runs/*/metrics.jsonl"), *folder.glob("references/*/scores.csv")]
    before = [(file, file.stat().st_ino, file.stat().st_mtime_ns) for file in files]
    assert len(before) == 3
    assert cli.main([*ARGV, "--out", str(folder), "--json"]) == 0
    assert [(file, file.stat().st_ino, file.stat().st_mtime_ns) for file in files] == before
    printed = capsys.readouterr()
    assert "BC (ST), published" in printed.out
    assert "MoveToCorner" not in printed.out
    assert json.loads(printed.out.splitlines()[-1])["rows"]
    assert f"report: {folder / 'report.html'}" in printed.err


def test_it_is_a_plan_that_can_be_run() -> None:
    plan = read_plan(find_plan("quickstart"))
    assert plan.tasks == ("MoveToRegion", "MoveToCorner")
    assert plan.references == ("expert", "random")
    assert plan.num_demos == plan.expert_demos == 25
