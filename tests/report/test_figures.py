"""Learning curves, and rollouts that are run again."""

import io
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from PIL import Image

from magical.envs import EnvId
from magical.errors import PolicyError
from magical.evaluation import (
    Evaluation,
    NoopPolicy,
    Policy,
    RandomPolicy,
    RolloutScore,
    environments,
)
from magical.evaluation.rollouts import roll_out
from magical.report import figures
from magical.report.figures import curves_by_task, extremes, record_reels, record_rollouts
from magical.report.found import Result
from tests.entries import entry_of
from tests.report.conftest import make_entry

pytest.importorskip("matplotlib", reason="the report extra is not installed")

DEMO = EnvId("MoveToRegion", "Demo")


def run_folder(path: Path, lines: Sequence[Mapping[str, float | None]]) -> Path:
    path.mkdir(parents=True)
    (path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_a_figure_for_each_task_and_quantity_and_a_line_for_each_run(tmp_path: Path) -> None:
    lines: list[dict[str, float | None]] = [
        {"step": i, "loss": 1 / (i + 1), "accuracy": i / 100} for i in range(100)
    ]
    lines[7]["loss"] = None  # was not finite
    lines.append({"step": 100, "loss": 1e308})  # cannot be drawn
    for name in ("one", "two"):
        run_folder(tmp_path / name, lines)
    run_folder(tmp_path / "x", [{"step": 1}])
    line, dupe = {"MakeLine-Demo": [1.0]}, {"FindDupe-Demo": [1.0]}
    evaluated = [("one", line, "one"), ("two", line, "two"), ("one", dupe, "x")]
    results = [
        Result(tmp_path / f"{method}-scores", make_entry(method, scores), tmp_path / run)
        for method, scores, run in evaluated
    ]
    shown, damaged = curves_by_task([*results, Result(tmp_path, make_entry("one", dupe))])
    assert (list(shown), damaged) == (["MakeLine"], {})
    for svg, name in zip(shown["MakeLine"], ("loss", "accuracy"), strict=True):
        for text in (name, "step", "one", "two"):
            assert f">{text}</text>" in svg


def test_a_picture_of_every_metric_in_the_run_folder(tmp_path: Path) -> None:
    empty = run_folder(tmp_path / "empty", [{"step": 0, "entropy": None}])
    assert figures.save_learning_curves(empty) is None
    lines = [{"step": step, "loss": 1.0 / step, "entropy": None} for step in (1, 2, 3)]
    picture = figures.save_learning_curves(run_folder(tmp_path / "run", lines))
    assert picture == tmp_path / "run" / "learning-curves.png"
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_reports_need_neither_pytorch_nor_learning() -> None:
    code = (
        "import sys, magical.report.leaderboard; "
        "sys.exit(bool({'torch', 'safetensors', 'magical_baselines'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def rows(*scores: float) -> list[RolloutScore]:
    return [RolloutScore(DEMO, i, i, score, 0.0) for i, score in enumerate(scores)]


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ((0.5, 1.0, 0.0, 1.0, 0.2), {"best": 3, "median": 0, "worst": 2}),
        ((1.0, 1.0), {"every rollout": 0}),
        ((0.0, 1.0), {"best": 1, "median": 0}),
    ],
)
def test_extremes_are_chosen_by_score_then_number(
    scores: Sequence[float], expected: Mapping[str, int]
) -> None:
    assert {name: row.rollout for name, row in extremes(rows(*scores))} == expected


def test_rollouts_are_recorded_as_they_were_evaluated() -> None:
    evaluation = Evaluation.of(environments(["MoveToRegion"], ["Demo", "All"]), rollouts=2)
    scores = roll_out(RandomPolicy(), evaluation, workers=0)
    rollouts = [(row.env_id, row.rollout) for row in scores]
    clips = record_rollouts(RandomPolicy(), evaluation, rollouts, size=32, every=7)
    assert [clip.score for clip in clips] == [row.score for row in scores]
    for clip, row in zip(clips, scores, strict=True):
        assert clip.frames.shape == (7, 32, 32, 3)  # the first, steps 7 to 35, and step 40
        env = gymnasium.make(row.env_id, observation={"parts": [["allo", 1]], "size": 32})
        np.testing.assert_array_equal(clip.frames[0], env.reset(seed=row.seed)[0])
        assert (clip.frames[0] != clip.frames[-1]).any()
    evaluation = Evaluation.of([DEMO], rollouts=1, horizon=20, nudge=1e-4)
    (clip,) = record_rollouts(RandomPolicy(), evaluation, [(DEMO, 0)], size=16)
    assert clip.score == roll_out(RandomPolicy(), evaluation, workers=0)[0].score
    with Image.open(io.BytesIO(clip.webp())) as picture:
        assert (getattr(picture, "n_frames", 1), picture.size) == (21, (16, 16))
    assert clip.strip(3).shape == (16, 48, 3)
    np.testing.assert_array_equal(clip.strip(3)[:, 16:32], clip.frames[10])


def test_a_reel_shows_the_median_run_and_says_what_differs_or_is_not_shown() -> None:
    scores = {"a": (0.5,), "b": (0.0,), "c": (0.0,), "m": (0.9, 0.1, 0.5)}
    results = [
        Result(Path(f"{method}{score}"), entry_of(method, rows(score, score)))
        for method, of_method in scores.items()
        for score in of_method
    ]
    loaded = []

    def load(result: Result) -> Policy:
        loaded.append(result.folder.name)
        if result.entry.method == "b":
            raise PolicyError("no such policy")
        return NoopPolicy()

    reels, notes = record_reels(results, load, 2)
    assert list(reels) == ["a on MoveToRegion"]
    ((uri, caption),) = reels["a on MoveToRegion"]
    assert uri.startswith("data:image/webp")
    assert caption == "Demo, every rollout: 0.00 (recorded: 0.50)"
    assert notes[0] == "b on MoveToRegion: no such policy"
    assert notes[1].endswith(": c on MoveToRegion, m on MoveToRegion")
    (((_, caption),),) = record_reels(results[2:3], load, 1)[0].values()
    assert caption == "Demo, every rollout: 0.00"
    record_reels(results[3:], load, 1)
    assert loaded == ["a0.5", "b0.0", "c0.0", "m0.5"]
