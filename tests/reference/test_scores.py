"""Comparison of both scoring rules with recorded final states."""

import pytest

from tests.reference import scores
from tests.reference.recordings import DATA


def test_the_recording_distinguishes_the_rules_and_a_wrong_score_is_detected() -> None:
    recorded = scores.load(DATA / "scores.json.gz")
    differing = {s["task"] for s in recorded if s["score"] != s["published_code_score"]}
    assert differing == {"ClusterColour", "ClusterShape", "FindDupe", "MakeLine"}
    computed = scores.compute(recorded[:1])
    computed[0]["published_code_score"] += 1e-6
    (comparison,) = scores.compare(recorded[:1], computed)
    assert not comparison.passed
    assert comparison.figure == pytest.approx(1e-6)
