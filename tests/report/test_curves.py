"""Learning curves."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from magical.report import figures as curves
from magical.report.figures import curves_by_task, save_learning_curves
from magical.report.found import Result
from tests.report.conftest import make_entry

pytest.importorskip("matplotlib", reason="the report extra is not installed")


def run_folder(path: Path, lines: Sequence[Mapping[str, float | None]]) -> Path:
    path.mkdir(parents=True)
    (path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_a_figure_for_each_task_and_quantity_and_a_line_for_each_run(tmp_path: Path) -> None:
    lines: list[dict[str, float | None]] = [
        {"step": i, "loss": 1 / (i + 1), "accuracy": i / 100} for i in range(100)
    ]
    lines[7]["loss"] = None  # was not finite
    for name in ("one", "two"):
        run_folder(tmp_path / name, lines)
    run_folder(tmp_path / "x", [{"step": 1}])
    line, dupe = {"MakeLine-Demo": [1.0]}, {"FindDupe-Demo": [1.0]}
    evaluated = [("one", line, "one"), ("two", line, "two"), ("one", dupe, "x"), ("one", dupe, "")]
    figures, damaged = curves_by_task(
        [
            Result(tmp_path / f"{method}-scores", make_entry(method, scores), tmp_path / run)
            for method, scores, run in evaluated
        ]
    )
    assert damaged == {}
    assert list(figures) == ["MakeLine"]
    for svg, name in zip(figures["MakeLine"], ("loss", "accuracy"), strict=True):
        assert svg.startswith("<svg")
        for text in (name, "step", "one", "two"):
            assert f">{text}</text>" in svg


def test_a_picture_of_every_metric_in_the_run_folder(tmp_path: Path) -> None:
    assert save_learning_curves(run_folder(tmp_path / "new", [])) is None
    assert save_learning_curves(run_folder(tmp_path / "empty", [{"step": 0}])) is None
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
        "sys.exit(bool({'torch', 'safetensors', 'magical_baselines'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("count", [1, 9, 95, 100, 499, 500, 5000])
def test_smoothing_keeps_the_newest_rows_and_draws_enough_points(count: int) -> None:
    points = [(float(i), float(i)) for i in range(count)]
    xs, ys = curves._smooth(points)
    width = max(1, min(curves.SMOOTHING, count // 10))
    assert xs[-1] == count - 1
    assert ys[-1] == pytest.approx(np.mean([y for _, y in points[-width:]]))
    assert min(count, curves.MAX_POINTS) <= len(xs) <= 2 * curves.MAX_POINTS
    assert ys[0] == pytest.approx(np.mean([y for x, y in points[:width] if x <= xs[0]]))
