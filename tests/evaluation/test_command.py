"""The evaluate command."""

import json
from pathlib import Path

import pytest

from magical import cli
from magical.commands.evaluate import print_scores
from magical.envs import EnvId
from magical.evaluation import RolloutScore, read_entry
from magical.report.leaderboard import faults
from magical.runs import write_json
from magical.tasks import unregister_task

POLICY = """
import numpy as np
def wrong(observations, env_ids, rng):
    return np.zeros(len(env_ids))
wrong.observation = "state"
def still(observations, env_ids, rng):
    return np.zeros(len(env_ids), int)
still.observation = "nothing"
"""


def evaluate(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    status = cli.main(["evaluate", *argv, "--workers", "0"])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_json_is_by_variant_and_of_several_tasks_by_task(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, _ = evaluate(capsys, "noop", "--task", "MoveToRegion", "--rollouts", "3", "--json")
    assert status == 0
    summary = json.loads(out.splitlines()[-1])
    assert list(summary) == ["Demo", "Jitter", "Layout", "Colour", "Dynamics", "All"]
    assert set(summary["Demo"]) == {"mean", "std", "scores", "published_code_mean"}
    assert len(summary["Demo"]["scores"]) == 3
    assert "95% interval" in out
    assert "do not include the spread between training runs" in out
    argv = ["--task", "MoveToRegion", "FixColour", "--variants", "Demo", "TestJitter"]
    _, out, _ = evaluate(capsys, "noop", *argv, "--rollouts", "1", "--json")
    summary = json.loads(out.splitlines()[-1])
    assert {task: list(cells) for task, cells in summary.items()} == {
        "MoveToRegion": ["Demo", "Jitter"],
        "FixColour": ["Demo", "Jitter"],
    }


def test_gaps_are_those_of_the_statistics(capsys: pytest.CaptureFixture[str]) -> None:
    means = {
        "MakeLine": {"Demo": 0.9, "TestJitter": 0.8, "TestAll": 0.5},
        "FindDupe": {"Demo": 1.0, "TestAll": 0.8},
    }
    scores = [
        RolloutScore(EnvId(task, variant), 0, 0, mean, 0.0)
        for task, cells in means.items()
        for variant, mean in cells.items()
    ]
    print_scores(scores)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    gaps = {tuple(words[:2]): words[-2] for words in lines if words[0] in means}
    assert gaps[("MakeLine", "Jitter")] == "0.100"
    assert gaps[("MakeLine", "All")] == "0.400"
    assert gaps[("FindDupe", "All")] == "0.200"
    assert "generalisation gap (Demo minus TestAll): 0.300 (" in " ".join(lines[-2])


def test_a_policy_with_wrong_outputs_says_what_was_expected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "wrong.py").write_text(POLICY)
    status, _, err = evaluate(capsys, f"{tmp_path / 'wrong.py'}:wrong", "--task", "MoveToRegion")
    assert status == 1
    assert (
        "policy: act(): actions: expected integers from 0 to 17 of shape (60,), found <array" in err
    )
    assert "f64>; sample or take the argmax" in err
    two = "def two(observations, env_ids):\n    return 0\nclass Two:\n    act = staticmethod(two)\n"
    (tmp_path / "two.py").write_text(two)
    for name in ("two", "Two"):
        status, _, err = evaluate(capsys, f"{tmp_path / 'two.py'}:{name}", "--task", "MoveToRegion")
        assert status == 1
        assert f"two.py:{name}: expected an object with act(observations, env_ids, rng), " in err
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    status, _, err = evaluate(capsys, str(tmp_path))
    assert status == 1
    assert "expected a run folder" in err


def test_out_holds_an_entry(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    argv = ["--task", "ClusterColour", "--variants", "Demo", "--rollouts", "2", "--horizon", "320"]
    more = ["--method", "dice", "--seed", "3", "--noise", "1e-9"]
    _, out, _ = evaluate(capsys, "random", *argv, *more, "--out", str(tmp_path))
    assert "generalisation gap" not in out  # without a test variant
    entry = read_entry(tmp_path)
    assert (entry.method, entry.evaluated.seed, entry.evaluated.nudge) == ("dice", 3, 1e-9)
    assert entry.evaluated.horizon_name == "appendix"  # whose number of steps was given
    assert [row.seed for row in entry.scores] == [1_003_000_000, 1_003_000_001]
    _, _, err = evaluate(capsys, "random", *argv, "--out", str(tmp_path))
    assert f"replaces the scores in {tmp_path}: 2 rollouts in 1 environments, nudge 1e-09" in err
    written = (tmp_path / "entry.json").read_bytes()
    status, _, err = evaluate(capsys, "noop", *argv, "--out", str(tmp_path))
    assert (status, f"{tmp_path}: belongs to 'random'; choose another" in err) == (2, True)
    assert (tmp_path / "entry.json").read_bytes() == written


def test_no_scores_of_another_policy_in_a_run_folder(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    write_json(tmp_path / "config.json", {"algorithm": "bc"})
    status, _, err = evaluate(capsys, "noop", "--out", str(tmp_path))
    assert (status, "belongs to 'the run in it'; choose" in err) == (2, True)


def test_import_registers_the_tasks_of_a_module(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "renamed.py"
    file.write_text(
        "import dataclasses, magical.tasks\n"
        "TASK = dataclasses.replace(magical.tasks.get_task('MakeLine'), name='Renamed')\n"
    )
    argv = ["--task", "Renamed", "--variants", "Demo", "--rollouts", "1"]
    assert evaluate(capsys, "noop", *argv)[0] == 2
    try:
        assert evaluate(capsys, "noop", *argv, "--import", str(file))[0] == 0
    finally:
        unregister_task("Renamed")


@pytest.mark.parametrize(
    ("argv", "status", "message"),
    [
        (["ranodm"], 2, "expected one of random"),
        (["noop", "--task", "MoveToRegoin"], 2, "did you mean 'MoveToRegion'"),
        (["noop", "--task", "MoveToCorner", "--variants", "Layout"], 2, "MoveToCorner has none"),
        (["noop", "--variants", "Color"], 2, "'Color' is not a variant"),
        (["no_module:thing"], 1, "cannot be imported"),
        (["noop", "--rollouts", "0"], 2, "at least 1"),
        (["noop", "--horizon", "soon"], 2, "soon"),
        *((["noop", f"--noise={nudge}"], 2, "--noise") for nudge in ("x", "-1", "1", "nan")),
        (
            ["noop", "--horizon", "published", "--task", "MoveToRegion"],
            2,
            "found tasks with one horizon only: MoveToRegion (40 steps); leave it out",
        ),
    ],
)
def test_wrong_arguments(
    capsys: pytest.CaptureFixture[str], argv: list[str], status: int, message: str
) -> None:
    found, _, err = evaluate(capsys, *argv)
    assert found == status
    assert message in err


def test_what_cannot_be_written_or_verified_is_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "seeing.py").write_text(POLICY + "wrong.observation = 'LoRes4A'\n")
    argv = [f"{tmp_path / 'seeing.py'}:wrong", "--task", "MoveToRegion"]
    status, _, err = evaluate(capsys, *argv, "--out", str(tmp_path / "file"))
    assert (status, "File exists" in err) == (1, True)
    status, _, err = evaluate(capsys, *argv, "--observation", "LoRes4E")
    assert (status, "the policy states its own observation, LoRes4A" in err) == (2, True)


def test_one_command_writes_an_entry_that_ranks(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text(POLICY)
    argv = [f"{tmp_path / 'own.py'}:still", "--task", "MoveToRegion", "--leaderboard"]
    stated = ["--method", "mine", "--learned-from", "demonstrations", "--test-evaluations", "2"]
    status, _, _ = evaluate(capsys, *argv, *stated, "--out", str(tmp_path / "entry"))
    assert status == 0
    entry = read_entry(tmp_path / "entry")
    assert faults(entry) == []
    assert (entry.method, entry.evaluated.nudge, entry.record.test_evaluations) == ("mine", 1e-9, 2)


def test_a_training_seed_tells_runs_apart(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text(POLICY)
    argv = [f"{tmp_path / 'own.py'}:still", "--task", "MoveToRegion", "--rollouts", "1"]
    argv += ["--training-seed", "3"]
    assert evaluate(capsys, *argv, "--out", str(tmp_path / "entry"))[0] == 0
    assert read_entry(tmp_path / "entry").record.training_seed == 3
    status, _, err = evaluate(capsys, *argv)
    assert (status, "--training-seed needs --out" in err) == (2, True)


def test_what_it_learned_from_is_stated_again_when_an_entry_is_made_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text(POLICY)
    folder = tmp_path / "entry"
    argv = [f"{tmp_path / 'own.py'}:still", "--task", "MoveToRegion", "--out", str(folder)]
    stated = ["--learned-from", "demonstrations"]
    assert evaluate(capsys, *argv, *stated, "--test-evaluations", "3")[0] == 0
    status, _, err = evaluate(capsys, *argv, "--leaderboard")
    assert (status, "expected learned_from in the record" in err) == (2, True)
    assert evaluate(capsys, *argv, "--leaderboard", *stated)[0] == 0
    assert faults(read_entry(folder)) == []
    assert read_entry(folder).record.test_evaluations == 3


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ([], "expected learned_from in the record"),
        (["--learned-from", "magic"], "'magic' is not a source"),
        (["--learned-from", "--rollouts", "3"], "3 rollouts of each environment"),
        (["--learned-from", "--variants", "Demo"], "MoveToRegion without Jitter"),
        (["--learned-from", "--horizon", "9"], "horizon 9, expected appendix"),
        (["--learned-from", "--seed", "1"], "set 1 of fixed seeds"),
        (["--learned-from", "--noise", "0.0001"], "nudge 0.0001, expected 1e-09"),
    ],
)
def test_what_would_not_rank_is_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, argv: list[str], message: str
) -> None:
    (tmp_path / "own.py").write_text(POLICY)
    policy = [f"{tmp_path / 'own.py'}:wrong", "--task", "MoveToRegion", "--leaderboard"]
    status, _, err = evaluate(capsys, *policy, *argv, "--out", str(tmp_path / "entry"))
    assert (status, (tmp_path / "entry").exists()) == (2, False)
    assert message in err
    assert evaluate(capsys, *policy, *argv)[0] == 2  # without --out
