"""Both scoring rules against the recorded final states, and damaged recordings."""

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from magical.conformance import scores
from magical.errors import RecordingError
from magical.tasks import TASKS


@pytest.fixture(scope="module")
def recorded(shared: Path) -> list[scores.Entry]:
    return scores.load(shared / "reference" / "scores.json.gz")


def test_every_score_equals_the_recorded_one(recorded: list[scores.Entry]) -> None:
    lines = scores.compare(recorded, scores.compute(recorded))
    assert {line.name for line in lines} == set(TASKS)
    assert [line for line in lines if not line.passed] == []
    assert max(line.figure for line in lines) <= 1e-9


def test_the_recording_holds_both_rules_apart(recorded: list[scores.Entry]) -> None:
    differing = {e["task"] for e in recorded if e["score"] != e["published_code_score"]}
    assert differing == {"ClusterColour", "ClusterShape", "FindDupe", "MakeLine"}


def test_a_wrong_score_misses_the_limit(recorded: list[scores.Entry]) -> None:
    computed = scores.compute(recorded[:1])
    computed[0]["published_code_score"] += 1e-6
    (line,) = scores.compare(recorded[:1], computed)
    assert not line.passed
    assert line.figure == pytest.approx(1e-6)


def entry() -> dict[str, Any]:
    """A recorded state without its scores."""
    demo = TASKS["MoveToCorner"].demo.to_dict()
    final = {"robot": demo["robot"], "blocks": [["square", "red", -0.8, 0.8, 0.0]]}
    return {"task": "MoveToCorner", "variant": "Demo", "scene": demo, "final": final}


def test_without_scores_it_only_computes_and_writes(tmp_path: Path) -> None:
    path, out = tmp_path / "in.json", tmp_path / "out.json"
    path.write_text(json.dumps([entry(), entry()]))
    data = scores.load(path)
    computed = scores.compute(data)
    assert scores.compare(data, computed) == []
    scores.write(computed, out)
    expected = {"score": 1.0, "published_code_score": 1.0}
    assert json.loads(out.read_text()) == [expected, expected]
    assert sorted(tmp_path.iterdir()) == [path, out]


DAMAGES: dict[str, Any] = {
    "no list": {},
    "no state": [3],
    "no final": [{k: v for k, v in entry().items() if k != "final"}],
    "unknown task": [entry() | {"task": "MoveToMoon"}],
    "another number of blocks": [entry() | {"final": {"robot": [0, 0, 0], "blocks": []}}],
    "a scene without blocks": [entry() | {"scene": {"robot": [0, 0, 0]}}],
    "a score in words": [entry() | {"score": "high"}],
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_file_is_named(damage: object, tmp_path: Path) -> None:
    path = tmp_path / "scores.json"
    path.write_text(json.dumps(damage))
    with pytest.raises(RecordingError, match=r"scores\.json: .*expected"):
        scores.load(path)


def test_a_torn_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "scores.json.gz"
    whole = gzip.compress(json.dumps([entry()]).encode())
    for torn in (whole[:-20], whole[:20] + b"\xff\xff" + whole[22:], b"", b"\xff\xfe"):
        path.write_bytes(torn)
        with pytest.raises(RecordingError, match=r"scores\.json\.gz: expected JSON"):
            scores.load(path)
    with pytest.raises(RecordingError, match="cannot be read"):
        scores.load(tmp_path / "missing.json")
