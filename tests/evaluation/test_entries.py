"""Scores and entries on disk, each in a folder or many in two files, and summed up."""

import errno
import gzip
import json
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.errors import ScoresError
from magical.evaluation import (
    Entry,
    Evaluation,
    FunctionPolicy,
    Record,
    RolloutScore,
    read_entry,
    read_scores,
    summarise,
)
from magical.evaluation import entry as entries
from magical.evaluation.entry import read_collection, write_collection
from tests.entries import entry_of

LINE, DUPE = EnvId("MakeLine", "Demo"), EnvId("FindDupe", "Demo")
HEADER = "env_id,rollout,seed,score,published_code_score\n"


def rows(env_id: EnvId, *scores: float, seed: int = 0) -> list[RolloutScore]:
    return [
        RolloutScore(env_id, i, evaluation_seed(i, seed), score, score / 3)
        for i, score in enumerate(scores)
    ]


SCORES = rows(LINE, 0.5, 1.0) + rows(EnvId("MakeLine", "TestJitter"), 1 / 3, 0.1 + 0.2)


def test_a_summary_is_by_variant_and_nested_for_several_tasks() -> None:
    summary = summarise(SCORES)
    assert list(summary) == ["Demo", "Jitter"]
    assert summary["Demo"] == {
        "mean": 0.75,
        "std": 0.25,  # over rollouts
        "scores": [0.5, 1.0],
        "published_code_mean": 0.25,
    }
    json.dumps(summary)
    assert summarise([SCORES[i] for i in (0, 2, 1, 3)]) == summary  # rows may come in any order
    nested = summarise([*SCORES, *rows(DUPE, 1.0)])
    assert list(nested) == ["MakeLine", "FindDupe"]
    assert nested["FindDupe"]["Demo"]["mean"] == 1.0


def test_entries_are_read_back_and_keep_their_notes(tmp_path: Path) -> None:
    record = {"notes": "by us", "test_evaluations": 2, "learned_from": [], "updates": [1, 2]}
    entry = entry_of("mine", SCORES, observation="LoRes4E", nudge=1e-9, record=record)
    entry.write(tmp_path)
    assert read_entry(tmp_path) == entry
    assert (tmp_path / "scores.csv").read_text().startswith(HEADER)
    entry_of("mine", SCORES[:1], record={"num_demos": 3}).write(tmp_path)
    again = read_entry(tmp_path)
    assert again.record == Record(notes="by us", test_evaluations=2, num_demos=3)
    assert again.scores == SCORES[:1]
    for number, largest in ((1, 2), (3, 3)):  # an earlier entry does not flatter a later one
        entry_of("mine", SCORES, record={"test_evaluations": number}).write(tmp_path)
        assert read_entry(tmp_path).record.test_evaluations == largest
    entry_of("mine", SCORES, record={"policy": "a.py:p"}).write(tmp_path)  # another one
    assert read_entry(tmp_path).record == Record(policy="a.py:p")


def test_entries_of_earlier_versions_are_read(tmp_path: Path) -> None:
    entry_of("mine", SCORES).write(tmp_path)
    details = {"looks": 2, "action_space": "continuous", "learned_from": ["score"]}
    (tmp_path / "entry.json").write_text(json.dumps({"method": "m", "details": details}))
    found = read_entry(tmp_path)
    assert found.evaluated.action_space == "continuous"
    assert found.record == Record(test_evaluations=2, learned_from=("score",))


def test_a_full_disk_leaves_the_previous_entry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry_of("mine", SCORES).write(tmp_path)

    def full(*args: object) -> None:
        raise OSError(errno.ENOSPC, "no space left on device")

    for where in ("write_scores", "write_atomically"):
        with monkeypatch.context() as patch:
            patch.setattr(entries, where, full)
            with pytest.raises(OSError, match="no space"):
                entry_of("mine", SCORES[:1], nudge=1e-4).write(tmp_path)
        found = read_entry(tmp_path)
        assert (found.evaluated.nudge, len(found.scores)) == (0.0, len(SCORES))


@pytest.mark.parametrize(
    ("attributes", "observation", "expected"),
    [
        ({}, None, ("LoRes4E", False)),
        ({"observation": "LoRes4A"}, None, ("LoRes4A", False)),
        ({}, "state", ("state", True)),
        ({"privileged": True}, "LoRes4E", ("state", True)),
        ({"observation": "nothing"}, None, ("nothing", False)),
    ],
)
def test_an_entry_says_what_the_policy_was_shown(
    attributes: dict[str, Any], observation: str | None, expected: tuple[str, bool]
) -> None:
    policy = FunctionPolicy(print, SimpleNamespace(**attributes))
    evaluation = Evaluation.of([LINE], observation=observation)
    entry = Entry.of(policy, evaluation, method="m", record=Record())
    assert (entry.observation, entry.evaluated.privileged) == expected


@pytest.mark.parametrize(("method", "rollouts"), [(" ", 1), ("m", 60_001)])
def test_what_could_not_be_read_again_is_no_entry(method: str, rollouts: int) -> None:
    evaluation = Evaluation.of([LINE], rollouts=rollouts)
    with pytest.raises(ScoresError, match="expected"):
        Entry.of(FunctionPolicy(print), evaluation, method=method, record=Record())


@pytest.mark.parametrize("missing", ["scores.csv", "entry.json"])
def test_half_an_entry_says_what_is_missing(tmp_path: Path, missing: str) -> None:
    entry_of("mine", SCORES).write(tmp_path)
    (tmp_path / missing).unlink()
    with pytest.raises(ScoresError, match=f"found no {missing}; `magical evaluate"):
        read_entry(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found nothing"),
        ("env,score\n", "expected the header env_id,rollout"),
        (f"{HEADER}{LINE},1,2\n", "line 2: expected env_id"),
        (f"{HEADER}{LINE},1,2,x,0.0\n", "line 2: could not convert string to float"),
        (f"{HEADER}a,1,2,0.5,0.5\n", "line 2: environment id 'a': expected magical/<Task>"),
        (f"{HEADER}magical/Gone-Demo-v0,1,2,0.5,0.5\n", "line 2: task 'Gone' is not registered"),
        (f"{HEADER}{LINE[:-3]}-LoRes4E-v0,1,2,0.5,0.5\n", "line 2: .* without preset"),
        (f"{HEADER}{LINE},1,2,0.5,0.5\n{LINE},1,2,1.5,0\n", "line 3: expected scores from 0 to 1"),
        (f"{HEADER}{LINE},1,2,nan,0.0\n", "line 2: expected scores from 0 to 1"),
        (HEADER + f"{LINE},0,0,0.5,0.5\n" * 60_001, "expected at most 60000 rows, found more"),
    ],
)
def test_damaged_scores_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scores.csv"
    path.write_text(text)
    with pytest.raises(ScoresError, match=message) as caught:
        read_scores(path)
    assert str(path) in str(caught.value)


def test_a_line_without_end_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "scores.csv"
    path.write_text(HEADER)
    with path.open("ab") as file:
        file.truncate(1 << 33)  # of zeros, which take no space
    with pytest.raises(ScoresError, match=r"line 2"):
        read_scores(path)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "{}",
        '{"method": "x", "colour": 1}',
        '{"method": "x", "record": {"big": 1e999}}',
        '{"method": "x", "record": {"a": ' + "[" * 40 + "]" * 40 + "}}",
        json.dumps({"method": "x" * 201}),
        '{"method": " "}',
        r'{"method": "\u001b[31mred"}',
        r'{"method": "m", "version": "1\n"}',
        '{"method": "m", "privileged": "no"}',
        '{"method": "m", "seed": -1}',
        '{"method": "m", "nudge": 5.0}',
        '{"method": "m", "horizon": "-1"}',
        '{"method": "m", "horizon": "soon"}',
    ],
)
def test_a_damaged_entry_is_named(tmp_path: Path, text: str) -> None:
    entry_of("mine", SCORES).write(tmp_path)
    (tmp_path / "entry.json").write_text(text)
    with pytest.raises(ScoresError, match=r"entry\.json.*expected") as caught:
        read_entry(tmp_path)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("scores", "seed", "message"),
    [
        ([], 0, "at least one environment, found none"),
        (rows(LINE, 0, 0)[:1] * 2, 0, "expected rollouts 0 to 1, each once"),
        (rows(LINE, 0, 0, 0)[::2], 0, "expected rollouts 0 to 1, each once"),
        (rows(LINE, 0, 0) + rows(DUPE, 0), 0, "FindDupe.*expected rollouts 0 to 1"),
        (rows(LINE, 0, 0), 3, "with seeds from 1003000000"),
        ([RolloutScore(LINE, -1, 999_999_999, 0.5, 0.5)], 0, "expected rollouts 0 to 0"),
    ],
)
def test_an_entry_that_breaks_the_protocol_is_refused(
    tmp_path: Path, scores: list[RolloutScore], seed: int, message: str
) -> None:
    entry_of("mine", scores, seed=seed).write(tmp_path)
    with pytest.raises(ScoresError, match=message) as caught:
        read_entry(tmp_path)
    assert str(tmp_path) in str(caught.value)


@given(st.sampled_from(["scores.csv", "entry.json"]), st.data())
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_other_bytes_are_read_or_refused(tmp_path: Path, name: str, data: Any) -> None:
    entry_of("mine", SCORES).write(tmp_path)
    whole = (tmp_path / name).read_bytes()
    start, end = sorted(data.draw(st.lists(st.integers(0, len(whole)), min_size=2, max_size=2)))
    changed = whole[:start] + data.draw(st.binary(max_size=20)) + whole[end:]
    (tmp_path / name).write_bytes(changed)
    with suppress(ScoresError):
        read_entry(tmp_path)


ENTRIES = {
    "runs/b": entry_of("B", SCORES, nudge=1e-9, record={"test_evaluations": 3}),
    "runs/a/leaderboard": entry_of("A", SCORES[:2]),
}


def test_collections_come_back_and_the_same_entries_give_the_same_bytes(tmp_path: Path) -> None:
    write_collection(tmp_path / "x", ENTRIES)
    assert read_collection(tmp_path / "x") == ENTRIES
    write_collection(tmp_path / "y", dict(reversed(ENTRIES.items())))
    for name in ("entries.json", "scores.csv.gz"):
        assert (tmp_path / "x" / name).read_bytes() == (tmp_path / "y" / name).read_bytes()
    assert (tmp_path / "x" / "scores.csv.gz").read_bytes()[4:8] == bytes(4)  # no time


def test_a_wrong_entry_of_a_collection_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    write_collection(tmp_path, ENTRIES)
    stated = json.loads((tmp_path / "entries.json").read_text())
    stated["runs/b"]["seed"] = 1
    stated["runs/c"] = {"method": "C"}
    (tmp_path / "entries.json").write_text(json.dumps(stated))
    found = read_collection(tmp_path)
    assert found["runs/a/leaderboard"] == ENTRIES["runs/a/leaderboard"]
    assert "runs/b: magical/MakeLine-Demo-v0: expected rollouts" in str(found["runs/b"])
    assert "runs/c: env_ids: expected at least one environment" in str(found["runs/c"])


def test_damaged_collections_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_collection(tmp_path, ENTRIES)
    file = tmp_path / "scores.csv.gz"
    whole = file.read_bytes()
    text = gzip.decompress(whole)
    for data, message in (
        (whole[:-20], "expected compressed scores"),
        (b"not compressed", "expected compressed scores"),
        (gzip.compress(text.replace(b"entry,", b"name,", 1)), "expected the header entry,env_id"),
    ):
        file.write_bytes(data)
        with pytest.raises(ScoresError, match=message):
            read_collection(tmp_path)
    file.write_bytes(whole)
    monkeypatch.setattr(entries, "COLLECTION_ROWS", 5)
    with pytest.raises(ScoresError, match="expected at most 5 rows"):
        read_collection(tmp_path)
