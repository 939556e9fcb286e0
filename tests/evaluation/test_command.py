"""The evaluate command."""

import json
from pathlib import Path

import pytest

from magical import cli
from magical.evaluation import read_entry
from magical.report.leaderboard import faults
from magical.runs import write_json

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
RANKED = ["noop", *REGION, "--leaderboard", "--out", "{own}-entry"]


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
    argv = [*REGION, "FixColour", "--variants", "Demo", "All", "--rollouts", "1", "--json"]
    _, out, _ = evaluate(capsys, "noop", *argv)
    assert "generalisation gap (Demo minus TestAll): " in out
    cells = {task: list(cells) for task, cells in json.loads(out.splitlines()[-1]).items()}
    assert cells == {"MoveToRegion": ["Demo", "All"], "FixColour": ["Demo", "All"]}


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
        (["{own}:wrong", *REGION, "--out", "{own}"], 1, "File exists"),
        (["{own}:wrong", *DEMO], 1, "expected integers from 0 to 17 of shape (2,), found <array"),
        (["{own}:two", *DEMO], 1, "own.py:two: expected an object with act(observations, env_ids"),
        (["{own}:wrong", "--out", "{own}-entry", "--learned-from", "magic"], 2, "'magic' is not"),
        # What would not rank is refused before anything runs.
        ([*RANKED, "--rollouts", "3"], 2, "3 rollouts of each environment"),
        ([*RANKED, "--horizon", "9"], 2, "horizon 9, expected appendix"),
        ([*RANKED, "--noise", "0.0001"], 2, "nudge 0.0001, expected 1e-09"),
    ],
)
def test_wrong_arguments(
    capsys: pytest.CaptureFixture[str], own: str, argv: list[str], status: int, message: str
) -> None:
    found, _, err = evaluate(capsys, *(word.format(own=own) for word in argv))
    assert (found, message in err) == (status, True), err
    assert not Path(f"{own}-entry").exists()


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
