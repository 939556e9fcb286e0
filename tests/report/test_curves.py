"""Learning curves."""

import json
from pathlib import Path

import pytest

from magical.errors import ScoresError
from magical.report.curves import learning_curves, read_metrics

pytest.importorskip("matplotlib", reason="the report extra is not installed")


def run_folder(path: Path, lines: list[dict[str, float]]) -> Path:
    path.mkdir(parents=True)
    (path / "metrics.jsonl").write_text("\n".join(map(json.dumps, lines)))
    return path


def test_a_panel_for_each_quantity_and_a_line_for_each_run(tmp_path: Path) -> None:
    lines = [{"batch": i, "loss": 1 / (i + 1), "accuracy": i / 100} for i in range(100)]
    runs = {name: run_folder(tmp_path / name, lines) for name in ("first run", "second run")}
    svg = learning_curves(runs)
    assert svg.startswith("<svg")
    for text in ("loss", "accuracy", "batch", "first run", "second run"):
        assert f"<!-- {text} -->" in svg


def test_without_metrics_there_is_nothing(tmp_path: Path) -> None:
    assert learning_curves({"run": tmp_path}) == ""
    assert learning_curves({"run": run_folder(tmp_path / "a", [{"batch": 1}])}) == ""


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "a", [{"batch": 1, "loss": 0.5}])
    with (folder / "metrics.jsonl").open("a") as file:
        file.write("\n{half")
    with pytest.raises(ScoresError, match=r"line 2: expected JSON, found \{half"):
        read_metrics(folder / "metrics.jsonl")
