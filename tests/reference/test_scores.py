"""Comparison of both scoring rules with recorded final states."""

import json
from pathlib import Path

import pytest

from magical.evaluation import published_tasks
from magical.tasks import TASKS
from tests.reference import scores
from tests.reference.recordings import DATA


@pytest.fixture(scope="module")
def recorded() -> list[scores.ScoredState]:
    return scores.load(DATA / "scores.json.gz")


def test_every_score_equals_the_recorded_one(recorded: list[scores.ScoredState]) -> None:
    comparisons = scores.compare(recorded, scores.compute(recorded))
    assert {each.name for each in comparisons} == set(published_tasks())
    assert [each for each in comparisons if not each.passed] == []
    assert max(each.figure for each in comparisons) <= 1e-9


def test_the_recording_distinguishes_the_two_rules(recorded: list[scores.ScoredState]) -> None:
    differing = {s["task"] for s in recorded if s["score"] != s["published_code_score"]}
    assert differing == {"ClusterColour", "ClusterShape", "FindDupe", "MakeLine"}


def test_a_wrong_score_misses_the_limit(recorded: list[scores.ScoredState]) -> None:
    computed = scores.compute(recorded[:1])
    computed[0]["published_code_score"] += 1e-6
    (comparison,) = scores.compare(recorded[:1], computed)
    assert not comparison.passed
    assert comparison.figure == pytest.approx(1e-6)


def test_without_scores_it_only_computes_and_writes(tmp_path: Path) -> None:
    path, out = tmp_path / "in.json", tmp_path / "out.json"
    demo = TASKS["MoveToCorner"].demo.to_dict()
    final = {**demo, "blocks": [["square", "red", -0.8, 0.8, 0.0]]}
    state = {"task": "MoveToCorner", "variant": "Demo", "scene": demo, "final": final}
    path.write_text(json.dumps([state, state]))
    data = scores.load(path)
    computed = scores.compute(data)
    assert scores.compare(data, computed) == []
    scores.write(computed, out)
    expected = {"score": 1.0, "published_code_score": 1.0}
    assert json.loads(out.read_text()) == [expected, expected]
    assert sorted(tmp_path.iterdir()) == [path, out]
