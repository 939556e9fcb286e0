"""Learning curves."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from magical.report.figures import curves
from magical.report.figures.curves import learning_curves, save_learning_curves

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
        assert f">{text}</text>" in svg


def test_without_metrics_there_is_nothing(tmp_path: Path) -> None:
    assert learning_curves({"run": tmp_path}) == ""
    assert learning_curves({"run": run_folder(tmp_path / "a", [{"step": 1}])}) == ""


def test_what_is_not_finite_is_left_out(tmp_path: Path) -> None:
    losses: list[float | None] = [0.5, None, 0.4]
    lines = [{"step": step, "loss": loss} for step, loss in enumerate(losses)]
    assert learning_curves({"run": run_folder(tmp_path / "a", lines)}).startswith("<svg")


def test_a_picture_of_every_metric_in_the_run_folder(tmp_path: Path) -> None:
    assert save_learning_curves(run_folder(tmp_path / "new", [])) is None
    lines = [{"step": step, "loss": 1.0 / step, "entropy": None} for step in (1, 2, 3)]
    lines[1]["entropy"] = 0.5
    picture = save_learning_curves(run_folder(tmp_path / "run", lines))
    assert picture == tmp_path / "run" / "learning-curves.png"
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_reports_need_neither_pytorch_nor_learning() -> None:
    code = (
        "import pkgutil, sys, importlib, magical.report; "
        "[importlib.import_module(module.name) "
        "for module in pkgutil.walk_packages(magical.report.__path__, 'magical.report.')]; "
        "sys.exit(bool({'torch', 'safetensors', 'magical.learning'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("count", [1, 9, 95, 100, 499, 500, 5000])
def test_smoothing_keeps_the_newest_rows_and_draws_enough_points(count: int) -> None:
    points = [(float(i), float(i)) for i in range(count)]
    xs, ys = curves._smooth(points)
    width = max(1, min(curves.SMOOTHING, count // 10))
    assert xs[-1] == count - 1
    assert ys[-1] == pytest.approx(np.mean([y for _, y in points[-width:]]))
    assert min(count, curves.MOST_POINTS) <= len(xs) <= 2 * curves.MOST_POINTS
    assert ys[0] == pytest.approx(np.mean([y for x, y in points[:width] if x <= xs[0]]))
