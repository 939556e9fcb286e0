"""The evaluate command."""

import json
from pathlib import Path

import pytest

from magical import cli
from magical.commands.evaluate import print_scores
from magical.envs import EnvId
from magical.evaluation import RolloutScore, read_entry
from magical.report.leaderboard import faults
from magical.runs.folder import write_json
from magical.tasks import unregister_task

POLICY = """
import numpy as np
def wrong(observations, env_ids, rng):
    return np.zeros(len(env_ids))
wrong.observation = "LoRes4A"
def still(observations, env_ids, rng):
    return np.zeros(len(env_ids), int)
still.observation = "nothing"
def two(observations, env_ids):
    return 0
"""
REGION = ["--task", "MoveToRegion"]
DEMO = [*REGION, "--variants", "Demo", "--rollouts", "2"]


@pytest.fixture
def own(tmp_path: Path) -> str:
    (tmp_path / "own.py").write_text(POLICY)
    return str(tmp_path / "own.py")


def evaluate(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    status = cli.main(["evaluate", *argv, "--workers", "0"])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_json_is_by_variant_and_of_several_tasks_by_task(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, _ = evaluate(capsys, "noop", *DEMO, "--json")
    assert status == 0
    (cell,) = json.loads(out.splitlines()[-1]).values()
    assert set(cell) == {"mean", "std", "scores", "published_code_mean"}
    assert len(cell["scores"]) == 2
    assert "95% interval" in out
    assert "do not include the spread between training runs" in out
    assert "generalisation gap" not in out  # without a test variant
    argv = [*REGION, "FixColour", "--variants", "Demo", "TestJitter", "--rollouts", "1", "--json"]
    summary = json.loads(evaluate(capsys, "noop", *argv)[1].splitlines()[-1])
    assert {task: list(cells) for task, cells in summary.items()} == {
        "MoveToRegion": ["Demo", "Jitter"],
        "FixColour": ["Demo", "Jitter"],
    }


def test_gaps_are_those_of_the_statistics(capsys: pytest.CaptureFixture[str]) -> None:
    means = {
        "MakeLine": {"Demo": 0.9, "TestJitter": 0.8, "TestAll": 0.5},
        "FindDupe": {"Demo": 1.0, "TestAll": 0.8},
    }
    print_scores(
        [
            RolloutScore(EnvId(task, variant), 0, 0, mean, 0.0)
            for task, cells in means.items()
            for variant, mean in cells.items()
        ]
    )
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    gaps = {tuple(words[:2]): words[-2] for words in lines if words[0] in means}
    assert gaps[("MakeLine", "Jitter")] == "0.100"
    assert gaps[("MakeLine", "All")] == "0.400"
    assert gaps[("FindDupe", "All")] == "0.200"
    assert "generalisation gap (Demo minus TestAll): 0.300 (" in " ".join(lines[-2])


def test_a_policy_that_is_none_says_what_was_expected(
    capsys: pytest.CaptureFixture[str], own: str
) -> None:
    status, _, err = evaluate(capsys, f"{own}:wrong", *DEMO)
    assert status == 1
    assert "act(): actions: expected integers from 0 to 17 of shape (2,), found <array" in err
    assert "f64>; sample or take the argmax" in err
    status, _, err = evaluate(capsys, f"{own}:two", *DEMO)
    assert status == 1
    assert "own.py:two: expected an object with act(observations, env_ids, rng), " in err
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    status, _, err = evaluate(capsys, str(Path(own).parent))
    assert (status, "expected a run folder" in err) == (1, True)


def test_out_holds_an_entry_and_keeps_another_policy_s(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    argv = [*DEMO, "--horizon", "40", "--out", str(tmp_path)]
    evaluate(capsys, "random", *argv, "--method", "dice", "--seed", "3", "--noise", "1e-9")
    entry = read_entry(tmp_path)
    assert (entry.method, entry.evaluated.seed, entry.evaluated.nudge) == ("dice", 3, 1e-9)
    assert entry.evaluated.horizon_name == "appendix"  # whose number of steps was given
    assert [row.seed for row in entry.scores] == [1_003_000_000, 1_003_000_001]
    _, _, err = evaluate(capsys, "random", *argv)
    assert f"replaces the scores in {tmp_path}: 2 rollouts in 1 environments, nudge 1e-09" in err
    written = (tmp_path / "entry.json").read_bytes()
    status, _, err = evaluate(capsys, "noop", *argv)
    assert (status, f"{tmp_path}: belongs to 'random'; choose another" in err) == (2, True)
    assert (tmp_path / "entry.json").read_bytes() == written
    write_json(tmp_path / "run" / "config.json", {"algorithm": "bc"})
    status, _, err = evaluate(capsys, "noop", *DEMO, "--out", str(tmp_path / "run"))
    assert (status, "belongs to 'the run in it'; choose" in err) == (2, True)


def test_import_registers_the_tasks_of_a_module(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "renamed.py"
    file.write_text(
        "import dataclasses, magical.tasks\n"
        "TASK = dataclasses.replace(magical.tasks.get_task('MoveToRegion'), name='Renamed')\n"
    )
    argv = ["--task", "Renamed", *DEMO[2:]]
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
        (["noop", "--noise", "nan"], 2, "--noise"),
        (["noop", *REGION, "--horizon", "published"], 2, "one horizon only: MoveToRegion (40 step"),
        (["noop", *REGION, "--training-seed", "3"], 2, "--training-seed needs --out"),
        (["{own}:wrong", "--observation", "LoRes4E"], 2, "states its own observation, LoRes4A"),
        (["{own}:wrong", *REGION, "--out", "{own}"], 1, "expected a folder, found a file"),
    ],
)
def test_wrong_arguments(
    capsys: pytest.CaptureFixture[str], own: str, argv: list[str], status: int, message: str
) -> None:
    found, _, err = evaluate(capsys, *(word.format(own=own) for word in argv))
    assert (found, message in err) == (status, True), err


def test_an_entry_that_ranks_states_what_was_learned_from_each_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, own: str
) -> None:
    argv = [f"{own}:still", *REGION, "--method", "mine", "--out", str(tmp_path / "entry")]
    stated = ["--learned-from", "demonstrations"]
    more = ["--test-evaluations", "3", "--training-seed", "7", "--rollouts", "1"]
    assert evaluate(capsys, *argv, *stated, *more)[0] == 0
    assert read_entry(tmp_path / "entry").record.training_seed == 7
    status, _, err = evaluate(capsys, *argv, "--leaderboard")
    assert (status, "expected learned_from in the record" in err) == (2, True)
    assert evaluate(capsys, *argv, *stated, "--leaderboard")[0] == 0
    entry = read_entry(tmp_path / "entry")
    assert faults(entry) == []
    assert (entry.method, entry.evaluated.nudge, entry.record.test_evaluations) == ("mine", 1e-9, 3)


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
    capsys: pytest.CaptureFixture[str], tmp_path: Path, own: str, argv: list[str], message: str
) -> None:
    policy = [f"{own}:wrong", *REGION, "--leaderboard"]
    status, _, err = evaluate(capsys, *policy, *argv, "--out", str(tmp_path / "entry"))
    assert (status, message in err) == (2, True)
    assert not (tmp_path / "entry").exists()
