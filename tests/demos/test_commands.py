"""`magical demos info` and `replay` on intact and damaged recordings."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from magical.cli import main
from magical.demos import Dataset, DatasetWriter
from magical.demos.store import manifest
from tests.demos.conftest import MakeTrajectory, Run


def test_info_counts_and_lists_problems(
    small_dataset: Path, make_trajectory: MakeTrajectory, run: Run
) -> None:
    first, second, _ = Dataset.open(small_dataset).entries
    writer = DatasetWriter(small_dataset)
    longer = make_trajectory(steps=14, seed=4, expert_actions=[1] * 14)
    labelled = writer.append(replace(longer, score=1.0, published_code_score=0.5))
    copy = writer.append(Dataset.open(small_dataset)[1])
    status, result = run("info", small_dataset)
    assert (status, result["count"], result["problems"]) == (0, 5, [])
    assert result["duplicates"] == [[copy.file, second.file]]
    corner = result["environments"][1]
    assert (corner["env_id"], corner["count"], corner["with_poses"]) == (labelled.env_id, 2, 2)
    assert (corner["with_expert_actions"], sum(corner["actions"])) == (1, 26)
    assert corner["lengths"] == [12, 13.0, 14]
    assert (corner["score"], corner["published_code_score"]) == (0.5, 0.25)
    (small_dataset / first.file).unlink()
    status, result = run("info", small_dataset)
    assert (status, result["count"]) == (1, 4)
    assert first.file in result["problems"][0]["file"]
    status, result = run("info", small_dataset, "--repair")
    assert (status, result["count"], result["problems"]) == (0, 4, [])


def test_a_repair_does_not_call_left_out_what_it_keeps(
    small_dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, *others = Dataset.open(small_dataset).entries
    wrong = [replace(first, score=0.125), *others]
    (small_dataset / manifest.NAME).write_text(manifest.new_text(wrong))
    assert main(["demos", "info", str(small_dataset), "--repair", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out.splitlines()[-1])["count"] == 3
    described = f"{small_dataset / first.file}: the manifest described another one"
    assert captured.err.splitlines() == [f"found: {described}"]


def test_replay_of_recordings_is_exact(small_dataset: Path, run: Run) -> None:
    status, result = run("replay", small_dataset)
    assert (status, result["agree"]) == (0, 3)
    assert [replay["departure"] for replay in result["replays"]] == [0.0] * 3
    for mean in result["environments"]:
        assert mean["published_code_score"] == mean["recorded"]
        assert (mean["exact"], mean["published_replay"]) == (mean["count"], None)


def test_replay_says_how_many_got_the_recorded_score(
    small_dataset: Path, tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    writer = DatasetWriter(tmp_path / "other")
    for number, trajectory in enumerate(Dataset.open(small_dataset)):
        by_rule = "score" if number == 0 else "published_code_score"
        wrong = {by_rule: abs(1.0 - getattr(trajectory, by_rule))} if number < 2 else {}
        writer.append(replace(trajectory, **wrong))
    status, result = run("replay", tmp_path / "other")
    assert (status, result["agree"]) == (0, 1)
    assert [one["agrees"] for one in result["replays"]] == [False, False, True]
    assert sum(mean["agree"] for mean in result["environments"]) == 1
    assert main(["demos", "replay", str(tmp_path / "other")]) == 0
    assert "1 of 3 replays reproduced the recorded score" in capsys.readouterr().out


def test_replay_skips_damaged_files(
    small_dataset: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = Dataset.open(small_dataset).entries[1]
    file = small_dataset / entry.file
    file.write_bytes(file.read_bytes()[:-9])
    status, result = run("replay", small_dataset)
    assert (status, len(result["replays"])) == (1, 2)
    assert main(["demos", "replay", str(small_dataset)]) == 1
    assert f"error: {file}" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["info", "replay", "export --to minari", "video --out v.webp"])
def test_missing_dataset(tmp_path: Path, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    command, *more = what.split()
    assert main(["demos", command, str(tmp_path / "none"), *more]) == 1
    assert "expected a dataset" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["import"], ["import", "x"], ["frobnicate"]])
def test_wrong_usage(arguments: list[str]) -> None:
    assert main(["demos", *arguments]) == 2
