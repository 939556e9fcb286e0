"""Runs that are counted, and evaluations that stand apart: report and leaderboard, end to end."""

import csv
import json
import os
from pathlib import Path
from typing import Any

import pytest

from magical import __version__, cli
from magical.evaluation import environments
from magical.report.found import find_results
from magical.runs import write_json
from tests.report.conftest import WriteEntry

ALIKE = {"MoveToRegion-Demo": [1.0, 0.0]}
BC = "BC (ST)"


def last_line(capsys: pytest.CaptureFixture[str], *argv: str) -> dict[str, Any]:
    assert cli.main([*argv, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return found


@pytest.mark.parametrize(
    ("policies", "seeds"),
    [
        (["mine.py:policy"] * 3, [None] * 3),
        (["a.zip", "b.zip", "c.zip"], [0] * 3),
        (["mine.py:policy"] * 3, [0, 1, 2]),
    ],
)
def test_runs_that_fail_alike_are_runs(
    write_entry: WriteEntry,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    policies: list[str],
    seeds: list[int | None],
) -> None:
    for number, mean in enumerate((0.0, 0.0, 1.0)):
        record: dict[str, Any] = {"learned_from": ["demonstrations"]}
        record["policy"] = policies[number]
        if (seed := seeds[number]) is not None:
            record["training_seed"] = seed
        write_entry(
            f"runs/{number}",
            "mine",
            {f"{i.task}-{i.variant}": [mean] * 100 for i in environments(["MoveToRegion"])},
            observation="LoRes4E",
            nudge=1e-9,
            version=__version__,
            record=record,
        )
    rows = last_line(capsys, "report", str(tmp_path / "runs"))["rows"]
    assert {(row["runs"], round(row["score"], 2)) for row in rows} == {(3, 0.33)}
    found = last_line(capsys, "leaderboard", str(tmp_path / "runs"))
    assert found["rejected"] == []
    (standing,) = found["boards"]["MoveToRegion"]
    assert round(standing["test_all"][0], 2) == 0.33


def test_evaluations_that_differ_have_rows_of_their_own(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    scores = {"ClusterColour-Demo": [1.0] * 100}
    write_entry("runs/a", "mine", scores, seed=0, observation="LoRes4E")
    write_entry("runs/b", "mine", {"ClusterColour-Demo": [0.5] * 100}, seed=1, horizon="320")
    for number, horizon in enumerate(("published", "240"), 3):
        write_entry(f"runs/{number}", "mine", scores, seed=number, horizon=horizon)
    write_entry("runs/c", "mine", {"ClusterColour-Demo": [0.0] * 5}, seed=2, observation="LoRes4A")
    for name in ("b", "3", "4"):
        file = tmp_path / "runs" / name / "entry.json"
        write_json(file, json.loads(file.read_text()) | {"observation": "LoRes4E"})
    out = tmp_path / "scores.csv"
    assert cli.main(["report", str(tmp_path / "runs"), "--out", str(out)]) == 0
    rows = list(csv.DictReader(out.read_text().splitlines()))
    columns = ["method", "runs", "score", "horizon", "observation", "rollouts"]
    assert [tuple(row[name] for name in columns) for row in rows] == [
        ("mine, LoRes4E, horizon 240", "2", "1", "240", "LoRes4E", "100"),
        ("mine, LoRes4E", "2", "0.75", "320", "LoRes4E", "100"),
        ("mine, LoRes4A, 5 rollouts", "1", "0", "320", "LoRes4A", "5"),
    ]
    columns = ["seed", "nudge", "action_space", "privileged"]
    assert {tuple(row[name] for name in columns) for row in rows} == {
        ("0", "0", "discrete", "False")
    }


def test_following_the_advice_shows_the_published_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    advice = "evaluate with --horizon published to compare"
    argv = ["evaluate", "noop", "--task", "ClusterColour", "--rollouts", "2", "--workers", "0"]
    argv += ["--variants", "Demo", "--method", BC, "--out"]
    report = ["report", str(tmp_path)]
    assert cli.main([*argv, str(tmp_path / "a")]) == 0
    assert cli.main(report) == 0
    assert advice in capsys.readouterr().out
    assert cli.main([*argv, str(tmp_path / "b"), "--horizon", "published"]) == 0
    capsys.readouterr()
    assert cli.main(report) == 0
    out, err = capsys.readouterr()
    assert "skipped" not in err
    assert advice not in out
    lines = [line.split("  ")[0] for line in out.splitlines() if line.startswith(BC)]
    assert lines[:2] == [BC, f"{BC}, horizon 240"]  # by the appendix's rule
    assert lines[2:4] == [f"{BC}, horizon 240", f"{BC}, published"]


def test_the_newer_of_two_evaluations_of_a_run_counts(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    old, new = (write_entry(name, "bc", ALIKE, seed=0) for name in ("a-old", "new"))
    for folder, time in ((old, 1e9), (new, 2e9)):
        os.utime(folder / "entry.json", (time, time))
    assert [result.folder for result in find_results([tmp_path]).results] == [new]
    data = json.loads((old / "entry.json").read_text())
    write_json(old / "entry.json", data | {"record": {"date": "2050-01-01T00:00:00Z"}})
    os.utime(old / "entry.json", (1e9, 1e9))
    assert [result.folder for result in find_results([tmp_path]).results] == [old]


@pytest.mark.parametrize("key", ["demonstrations", "num_demos"])
def test_runs_of_other_demonstrations_are_other_runs(
    write_entry: WriteEntry, tmp_path: Path, key: str
) -> None:
    for name, number in (("a", 10), ("b", 25), ("b-again", 25)):
        record = {
            "training_seed": 0,
            "date": f"2026-01-01T00:00:{number}Z",
            key: number if key == "num_demos" else f"{number}",
        }
        write_entry(name, "m", ALIKE, record=record)
    assert [result.folder.name for result in find_results([tmp_path]).results] == ["a", "b"]


def test_two_evaluations_of_one_run_folder_are_one_run(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_json(tmp_path / "run" / "config.json", {"algorithm": "bc"})  # a seed is not recorded
    for name, score in (("a", 0.0), ("b", 1.0)):
        record = {"policy": "../run", "demonstrations": name}
        write_entry(name, "bc", {"MoveToRegion-Demo": [score]}, record=record)
    assert len(find_results([tmp_path]).results) == 1
    for name in ("c", "d"):
        write_entry(name, "noop", ALIKE, record={"policy": "noop"})
    assert len(find_results([tmp_path / "c", tmp_path / "d"]).results) == 1
