"""The main job, with little of everything."""

import json
import re

import pytest

from magical import cli
from magical_baselines.experiments.status import read_status

for _extra in ("torch", "safetensors", "jinja2", "matplotlib"):
    pytest.importorskip(_extra, reason="the learning and report extras are not installed")

TASK = "MoveToRegion"  # the quickest
ARGV = ["quickstart", "--task", TASK, "--batches", "3", "--seed", "0", "--rollouts", "2"]
ARGV += ["--workers", "1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("quickstart")
    assert cli.main([*ARGV, "--out", str(path)]) == 0
    return path


def test_the_page_shows_all_parts(folder):
    text = (folder / "report.html").read_text()
    for word in ("expert", "random", "BC (ST), published", "BC quick on MoveToRegion", "<svg"):
        assert word in text
    assert len(re.findall("data:image/webp", text)) >= 6


def test_a_second_quickstart_takes_up_what_is_there(folder, capsys):
    files = [*folder.glob("runs/*/metrics.jsonl"), *folder.glob("references/*/scores.csv")]
    before = [(file, file.stat().st_ino, file.stat().st_mtime_ns) for file in files]
    assert len(before) == 3
    assert cli.main([*ARGV, "--out", str(folder), "--json"]) == 0
    assert [(file, file.stat().st_ino, file.stat().st_mtime_ns) for file in files] == before
    learned, fails, page, result = capsys.readouterr().out.splitlines()
    assert learned.startswith(f"BC quick, trained on 25 demonstrations of {TASK}, scores 0.")
    assert "the expert 1.00, random actions 0.00" in learned
    assert fails.startswith("It fails most where it scores 0.00 on MoveToRegion ")
    assert page.startswith(f"{folder / 'report.html'} shows all scores")
    assert {row["method"] for row in json.loads(result)["rows"]} == {"BC quick", "expert", "random"}
    text = (folder / "report.html").read_text()
    assert text.index(learned) < text.index("poses anywhere in the workspace") < text.index("<h2")
    assert set(ARGV[:-2]) <= set(read_status(folder).command)
