"""`magical demos info` and `replay`."""

from dataclasses import replace
from pathlib import Path

import pytest

from magical.cli import main
from magical.demos import Dataset, DatasetWriter
from tests.demos.conftest import MakeTrajectory, Run


def test_info_counts(small_dataset: Path, make_trajectory: MakeTrajectory, run: Run) -> None:
    writer = DatasetWriter(small_dataset)
    longer = make_trajectory(steps=14, seed=4, expert_actions=[1] * 14)
    writer.append(replace(longer, score=1.0, published_code_score=0.5))
    copy = writer.append(Dataset.open(small_dataset)[1])
    status, result = run("info", small_dataset)
    assert (status, result["count"]) == (0, 5)
    assert result["duplicates"] == [[copy.file, "000001.npz"]]
    corner = result["environments"][1]
    assert corner["env_id"] == "magical/MoveToCorner-Demo-v0"
    assert [corner[name] for name in ("count", "with_poses", "with_labels")] == [2, 2, 1]
    assert corner["lengths"] == [12, 14]
    assert (corner["score"], corner["published_code_score"]) == (0.5, 0.25)


def test_replays_agree_with_what_was_recorded(
    small_dataset: Path, tmp_path: Path, run: Run
) -> None:
    writer = DatasetWriter(tmp_path / "other")
    for number, trajectory in enumerate(Dataset.open(small_dataset)):
        by_rule = "score" if number == 0 else "published_code_score"
        wrong = {by_rule: abs(1.0 - getattr(trajectory, by_rule))} if number < 2 else {}
        writer.append(replace(trajectory, **wrong))
    for folder, expected in (
        (small_dataset, [True] * 3),
        (tmp_path / "other", [False, False, True]),
    ):
        status, result = run("replay", folder)
        assert (status, result["agree"]) == (0, sum(expected))
        assert [one["agrees"] for one in result["replays"]] == expected
        assert [one["departure"] for one in result["replays"]] == [0.0] * 3


@pytest.mark.parametrize("what", ["info", "replay", "export --to minari", "video --out v.mp4"])
def test_a_missing_dataset_is_named(
    tmp_path: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command, *more = what.split()
    assert main(["demos", command, str(tmp_path / "none"), *more]) == 1
    assert "expected a dataset" in capsys.readouterr().err


def test_terminal_escapes_are_shown_escaped(
    tmp_path: Path, make_trajectory: MakeTrajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    escapes = "\x1b[2J\x07"
    writer = DatasetWriter(tmp_path)
    for _ in range(2):
        writer.append(make_trajectory(demonstrator=escapes, metadata={"source": escapes}))
    assert main(["demos", "info", str(tmp_path)]) == 0
    shown = capsys.readouterr()
    assert all(line.isprintable() for line in (shown.out + shown.err).split("\n"))


@pytest.mark.parametrize("arguments", [[], ["import"], ["import", "x"], ["frobnicate"]])
def test_wrong_usage(arguments: list[str]) -> None:
    assert main(["demos", *arguments]) == 2
