"""Learning curves."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from magical.errors import ScoresError
from magical.report.curves import learning_curves, read_metrics

pytest.importorskip("matplotlib", reason="the report extra is not installed")


def run_folder(path: Path, lines: Sequence[Mapping[str, float | None]]) -> Path:
    path.mkdir(parents=True)
    (path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_a_panel_for_each_quantity_and_a_line_for_each_run(tmp_path: Path) -> None:
    lines = [{"step": i, "loss": 1 / (i + 1), "accuracy": i / 100} for i in range(100)]
    runs = {name: run_folder(tmp_path / name, lines) for name in ("first run", "second run")}
    svg = learning_curves(runs)
    assert svg.startswith("<svg")
    for text in ("loss", "accuracy", "step", "first run", "second run"):
        assert f"<!-- {text} -->" in svg


def test_without_metrics_there_is_nothing(tmp_path: Path) -> None:
    assert learning_curves({"run": tmp_path}) == ""
    assert learning_curves({"run": run_folder(tmp_path / "a", [{"step": 1}])}) == ""


def test_what_is_not_finite_is_left_out(tmp_path: Path) -> None:
    losses: list[float | None] = [0.5, None, 0.4]
    lines = [{"step": step, "loss": loss} for step, loss in enumerate(losses)]
    assert learning_curves({"run": run_folder(tmp_path / "a", lines)}).startswith("<svg")


@pytest.mark.parametrize("line", ["{half", "[]", '{"loss": 1}'])
def test_a_damaged_line_is_named(tmp_path: Path, line: str) -> None:
    folder = run_folder(tmp_path / "a", [{"step": 1, "loss": 0.5}])
    with (folder / "metrics.jsonl").open("a") as file:
        file.write(f"{line}\n")
    with pytest.raises(ScoresError, match=f"line 2: .* found {re.escape(line)}"):
        read_metrics(folder / "metrics.jsonl")


def test_a_last_line_that_was_cut_is_left_out(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "a", [{"step": 1, "loss": 0.5}])
    with (folder / "metrics.jsonl").open("a") as file:
        file.write('{"step": 2, "lo')
    assert read_metrics(folder / "metrics.jsonl") == [{"step": 1, "loss": 0.5}]
