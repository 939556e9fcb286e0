"""Rollouts as pictures, and the page."""

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from magical import cli
from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.evaluation import RolloutScore, environments
from magical.report.figures import Clip
from tests.entries import entry_of
from tests.report.conftest import WriteEntry
from tests.report.html_elements import Elements

pytest.importorskip("jinja2", reason="the report extra is not installed")
pytest.importorskip("matplotlib", reason="the report extra is not installed")

IDS = environments(["MoveToRegion"], ["Layout", "All"])


def test_a_clip_becomes_an_animation_and_a_strip() -> None:
    frames = np.zeros((9, 16, 16, 3), np.uint8)
    for step, frame in enumerate(frames):
        frame[:, step] = 255
    clip = Clip(1.0, frames)
    with Image.open(io.BytesIO(clip.webp())) as picture:
        assert getattr(picture, "n_frames", 1) == 9
        assert picture.size == (16, 16)
    strip = clip.strip(3)
    assert strip.shape == (16, 48, 3)
    np.testing.assert_array_equal(strip[:, 16:32], frames[4])


@pytest.fixture
def evaluated(tmp_path: Path) -> Path:
    demo = EnvId("MakeLine", "Demo")
    scores = [RolloutScore(demo, i, evaluation_seed(i), 1.0, 0.5) for i in range(3)]
    entry_of("mine", scores).write(tmp_path / "run")
    return tmp_path / "run"


def test_the_report_command_prints_tables_and_writes_a_page(
    evaluated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = evaluated / "report.html"
    argv = ["report", str(evaluated), "--published", "BC (ST)", "--out", str(page)]
    assert cli.main(argv) == 0
    printed = capsys.readouterr().out
    assert re.search(r"0\.50 \[0\.\d+, 0\.\d+\]", printed)
    assert "0.48 ± 0.08" in printed
    text = page.read_text()
    assert "BC (ST), published" in text
    for heading in ("Learning curves", "rollouts</h2>", "Generalisation gaps"):
        assert heading not in text  # empty parts


def test_the_report_command_names_what_is_missing(
    evaluated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["report", str(tmp_path / "none")]) == 1
    assert "none: expected a folder with scores.csv" in capsys.readouterr().err
    assert cli.main(["report", str(evaluated), "--out", str(tmp_path)]) == 2
    assert "expected a file, found the folder" in capsys.readouterr().err
    assert cli.main(["report", str(evaluated), "--published", "BC"]) == 2
    assert "BC (ST)" in capsys.readouterr().err


def test_the_report_of_a_folder_says_everything(
    write_entry: WriteEntry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scores = {"MoveToRegion-Demo": [1.0, 0.0], "MoveToRegion-TestAll": [0.0, 0.0]}
    for seed in (0, 1):
        folder = write_entry(f"runs/a{seed}", "<a>", scores, seed, record={"policy": "."})
        rows = [json.dumps({"step": step, "loss": 1 / (step + 1)}) for step in range(20)]
        rows += ['{"step": 21, "loss": null}']
        (folder / "metrics.jsonl").write_text("\n".join(rows) + "\n")
    write_entry("runs/b", "$b_1日本", scores, record={"policy": "noop"})
    (write_entry("runs/bad", "bad", scores) / "scores.csv").write_text("bad")
    (tmp_path / "runs" / "a1" / "metrics.jsonl").write_text("bad\n")
    page = tmp_path / "page.html"
    argv = ["report", str(tmp_path / "runs"), "--out", str(page), "--clips", "2"]
    assert cli.main(argv) == 0
    assert "skipped" in capsys.readouterr().err
    text = page.read_text()
    cli.main(argv)
    assert page.read_text() == text
    elements = Elements(text)
    assert elements.open == []
    addresses = [*elements.values("src"), *elements.values("href")]
    assert not [address for address in addresses if address.startswith(("http", "//"))]
    assert any(address.startswith("data:image/webp") for address in addresses)
    ids = elements.values("id")
    assert len(ids) == len(set(ids))
    used = re.findall(r'(?:url\(#|href="#)([^")]+)', text)
    assert set(used) <= set(ids)
    for words in (
        "3 evaluated runs of 2 methods; 2 skipped",
        "expected the header",
        "expected JSON, found something else",
        "Generalisation gaps",
        'aria-label="interquartile mean"',
        'aria-label="Learning curves: loss on MoveToRegion"',
        "$b_1日本 on MoveToRegion",
        "&lt;a&gt; on MoveToRegion: ",  # its run folder has no checkpoint
    ):
        assert words in text, words
