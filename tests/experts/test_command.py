"""`magical expert evaluate`."""

import json

import pytest

from magical import cli
from magical.evaluation import evaluate
from magical.evaluation.expert import ExpertPolicy

CORNER = "magical/MoveToCorner-Demo-v0"


def test_json_has_a_mean_a_deviation_and_all_scores(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["expert", "evaluate", "--env", CORNER, "MoveToRegion-Demo-LoRes4E-v0"]
    assert cli.main([*command, "--rollouts", "2", "--workers", "1", "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert list(result) == [CORNER, "magical/MoveToRegion-Demo-v0"]
    assert result[CORNER] == {"mean": 1.0, "std": 0.0, "scores": [1.0, 1.0]}


def test_scores_depend_on_the_seed_alone() -> None:
    ids = ["magical/MoveToRegion-TestLayout-v0", "magical/FixColour-TestLayout-v0"]
    policy = ExpertPolicy(random_share=0.3)
    one, two = (evaluate(policy, ids, rollouts=3, seed=5, workers=workers) for workers in (1, 2))
    assert one == two


def test_unknown_environment(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["expert", "evaluate", "--env", "MoveToMoon-Demo-v0"]) == 2
    assert "MoveToMoon" in capsys.readouterr().err
