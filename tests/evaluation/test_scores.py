"""Scores and entries on disk, and summed up."""

import errno
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.errors import ScoresError
from magical.evaluation import (
    BUILT_IN,
    Entry,
    Evaluation,
    FunctionPolicy,
    Record,
    RolloutScore,
    read_entry,
    read_scores,
    summarise,
    write_scores,
)
from magical.evaluation import entry as entries
from tests.entries import entry_of

SCORES = [
    RolloutScore(EnvId("MakeLine", "Demo"), 0, 1_000_000_000, 0.5, 0.0),
    RolloutScore(EnvId("MakeLine", "Demo"), 1, 1_000_000_001, 1.0, 1.0),
    RolloutScore(EnvId("MakeLine", "TestJitter"), 0, 1_000_000_000, 1 / 3, 0.25),
    RolloutScore(EnvId("MakeLine", "TestJitter"), 1, 1_000_000_001, 0.0, 0.0),
]
DEMO = "magical/MakeLine-Demo-v0"


def test_scores_are_read_back_unchanged(tmp_path: Path) -> None:
    write_scores(SCORES, tmp_path / "scores.csv")
    assert read_scores(tmp_path / "scores.csv") == SCORES
    header = (tmp_path / "scores.csv").read_text().splitlines()[0]
    assert header == "env_id,rollout,seed,score,published_code_score"


def test_a_summary_is_by_variant_and_nested_for_several_tasks() -> None:
    summary = summarise(SCORES)
    assert list(summary) == ["Demo", "Jitter"]
    assert summary["Demo"] == {
        "mean": 0.75,
        "std": 0.25,  # over rollouts
        "scores": [0.5, 1.0],
        "published_code_mean": 0.5,
    }
    json.dumps(summary)
    assert summarise([SCORES[i] for i in (0, 2, 1, 3)]) == summary  # rows may come in any order
    nested = summarise([*SCORES, RolloutScore(EnvId("FindDupe", "Demo"), 0, 0, 1.0, 1.0)])
    assert list(nested) == ["MakeLine", "FindDupe"]
    assert nested["FindDupe"]["Demo"]["mean"] == 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found nothing"),
        ("env,score\n", "expected the header env_id,rollout"),
        (f"{{}}{DEMO},1,2\n", "line 2: expected env_id"),
        (f"{{}}{DEMO},1,2,x,0.0\n", "line 2"),
        ("{}a,1,2,0.5,0.5\n", "line 2: environment id 'a': expected magical/<Task>"),
        ("{}magical/Gone-Demo-v0,1,2,0.5,0.5\n", "line 2: task 'Gone' is not registered"),
        ("{}magical/MakeLine-Demo-LoRes4E-v0,1,2,0.5,0.5\n", "line 2: expected env_id"),
        (f"{{}}{DEMO},1,2,0.5,0.5\n{DEMO},1,2,1.5,0.0\n", "line 3: expected scores from 0 to 1"),
        (f"{{}}{DEMO},1,2,nan,0.0\n", "line 2: expected scores from 0 to 1"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scores.csv"
    path.write_text(text.format("env_id,rollout,seed,score,published_code_score\n"))
    with pytest.raises(ScoresError, match=message) as caught:
        read_scores(path)
    assert str(path) in str(caught.value)


def test_entries_are_read_back_and_keep_their_notes(tmp_path: Path) -> None:
    record = {"notes": "by us", "test_evaluations": 2, "learned_from": [], "updates": [1, 2]}
    entry = entry_of("mine", SCORES, observation="LoRes4E", nudge=1e-9, record=record)
    entry.write(tmp_path)
    assert read_entry(tmp_path) == entry
    entry_of("mine", SCORES[:1], record={"num_demos": 3}).write(tmp_path)
    again = read_entry(tmp_path)
    assert again.record == Record(notes="by us", test_evaluations=2, num_demos=3)
    assert again.scores == SCORES[:1]
    entry_of("mine", SCORES, record={"policy": "a.py:p"}).write(tmp_path)  # another one
    assert read_entry(tmp_path).record == Record(policy="a.py:p")


@pytest.mark.parametrize(
    ("earlier", "stated", "expected"), [(20, None, 20), (20, 0, 20), (0, 2, 2), (None, 3, 3)]
)
def test_an_earlier_entry_does_not_flatter_a_later_one(
    tmp_path: Path, earlier: int | None, stated: int | None, expected: int
) -> None:
    for number in (earlier, stated):
        entry_of("mine", SCORES, record={"test_evaluations": number}).write(tmp_path)
    assert read_entry(tmp_path).record.test_evaluations == expected


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
        ({}, "LoResStack", ("LoResStack", False)),
        ({"observation": "state"}, None, ("state", True)),
        ({}, "state", ("state", True)),
        ({"privileged": True}, "LoRes4E", ("state", True)),
        ({"observation": "nothing"}, None, ("nothing", False)),
    ],
)
def test_an_entry_says_what_the_policy_was_shown(
    attributes: dict[str, Any], observation: str | None, expected: tuple[str, bool]
) -> None:
    policy = FunctionPolicy(print, SimpleNamespace(**attributes))
    evaluation = Evaluation.of([DEMO], observation=observation)
    entry = Entry.of(policy, evaluation, method="m", record=Record())
    assert (entry.observation, entry.evaluated.privileged) == expected


@pytest.mark.parametrize("missing", ["scores.csv", "entry.json"])
def test_half_an_entry_says_what_is_missing(tmp_path: Path, missing: str) -> None:
    entry_of("mine", SCORES).write(tmp_path)
    (tmp_path / missing).unlink()
    with pytest.raises(ScoresError, match="gone: expected a folder with"):
        read_entry(tmp_path / "gone")
    with pytest.raises(ScoresError, match=f"found no {missing}; `magical evaluate"):
        read_entry(tmp_path)


DEEP = '{"method": "x", "record": {"a": ' + "[" * 40 + "]" * 40 + "}}"


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "{}",
        '{"method": "x", "colour": 1}',
        '{"method": "x", "record": {"big": 1e999}}',
        DEEP,
        r'{"method": "\u001b[31mred"}',
        json.dumps({"method": "x" * 201}),
        '{"method": 3}',
        '{"method": " "}',
        '{"method": "m", "privileged": "no"}',
        '{"method": "m", "seed": -1}',
        '{"method": "m", "seed": true}',
        '{"method": "m", "record": []}',
        '{"method": "m", "nudge": 5.0}',
    ],
)
def test_a_damaged_entry_is_named(tmp_path: Path, text: str) -> None:
    entry_of("mine", SCORES).write(tmp_path)
    (tmp_path / "entry.json").write_text(text)
    with pytest.raises(ScoresError, match=r"entry\.json.*expected") as caught:
        read_entry(tmp_path)
    assert str(caught.value).isprintable()


def test_a_line_without_end_is_not_read_to_its_end(tmp_path: Path) -> None:
    write_scores(SCORES, tmp_path / "scores.csv")
    with (tmp_path / "scores.csv").open("ab") as file:
        file.truncate(1 << 33)  # of zeros, which take no space
    with pytest.raises(ScoresError, match=r"line 6"):
        read_scores(tmp_path / "scores.csv")


def test_an_entry_has_as_many_rows_as_the_protocol_can_need(tmp_path: Path) -> None:
    line = f"{DEMO},0,0,0.5,0.5\n"
    path = tmp_path / "scores.csv"
    path.write_text("env_id,rollout,seed,score,published_code_score\n" + line * 60_001)
    with pytest.raises(ScoresError, match="expected at most 60000 rows, found more"):
        read_scores(path)
    evaluation = Evaluation.of([DEMO], rollouts=60_001)
    with pytest.raises(ScoresError, match="expected at most 60000 rollouts in an entry"):
        Entry.of(BUILT_IN["noop"](), evaluation, method="mine", record=Record())


def rows(env_id: EnvId, numbers: list[int], seed: int = 0) -> list[RolloutScore]:
    return [RolloutScore(env_id, i, evaluation_seed(i, seed), 0.5, 0.5) for i in numbers]


LINE, DUPE = EnvId("MakeLine", "Demo"), EnvId("FindDupe", "Demo")


@pytest.mark.parametrize(
    ("scores", "seed", "message"),
    [
        ([], 0, "at least one rollout, found none"),
        (rows(LINE, [0, 1, 1]), 0, "rollout 1 once, found it twice"),
        (rows(LINE, [0, 2]), 0, "expected rollouts 0 to 1, found 2; missing: 1"),
        (rows(LINE, [0, 1]) + rows(DUPE, [0]), 0, "FindDupe.*expected rollouts 0 to 1, found 1"),
        (rows(LINE, [0, 1]), 3, "expected seed 1003000000 for rollout 0, found 1000000000"),
        ([RolloutScore(LINE, -1, 999_999_999, 0.5, 0.5)], 0, "rollout -1"),
    ],
)
def test_an_entry_that_breaks_the_protocol_is_refused(
    tmp_path: Path, scores: list[RolloutScore], seed: int, message: str
) -> None:
    entry_of("mine", scores, seed=seed).write(tmp_path)
    with pytest.raises(ScoresError, match=message) as caught:
        read_entry(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_seeded_fuzz_of_entries_raises_nothing_else(tmp_path: Path) -> None:
    """Mutated files are read, or refused with `ScoresError`."""
    entry_of("mine", SCORES).write(tmp_path)
    whole = {name: (tmp_path / name).read_bytes() for name in ("scores.csv", "entry.json")}
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        name = rng.choice(list(whole))
        data = bytearray(whole[name])
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        (tmp_path / name).write_bytes(bytes(data[: rng.integers(1, len(data) + 1)]))
        try:
            read_entry(tmp_path)
        except ScoresError:
            refused += 1
        (tmp_path / name).write_bytes(whole[name])
    assert refused > 300
