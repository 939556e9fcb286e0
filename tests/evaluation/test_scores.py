"""Scores and entries on disk, and summed up."""

import errno
import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magical.envs import EnvId
from magical.envs.action_spec import ActionSpaceName
from magical.envs.seeds import evaluation_seed
from magical.errors import ScoresError
from magical.evaluation import (
    BUILT_IN,
    Entry,
    Evaluation,
    FunctionPolicy,
    RolloutScore,
    read_entry,
    read_scores,
    summarise,
    write_scores,
)
from magical.evaluation import entry as entries
from magical.evaluation.expert import ExpertPolicy

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


def test_entries_are_read_back_and_keep_what_their_authors_added(tmp_path: Path) -> None:
    entry = Entry(
        method="mine", scores=SCORES, observation="LoRes4E", nudge=1e-9, details={"labels": 10}
    )
    entry.write(tmp_path)
    assert read_entry(tmp_path) == entry
    Entry(method="mine", scores=SCORES[:1], details={"note": "again"}).write(tmp_path)
    again = read_entry(tmp_path)
    assert again.details == {"labels": 10, "note": "again"}
    assert again.scores == SCORES[:1]
    trained = {"algorithm": "bc", "num_demos": 2, "pretrained_on": [], "note": "mine"}
    for stated in (trained, {"algorithm": "ppo"}):  # the run folder holds another run now
        Entry(method="run", scores=SCORES, details=stated).write(tmp_path)
    assert read_entry(tmp_path).details == {"algorithm": "ppo", "note": "mine"}
    for details in ({"policy": "noop", "learned_from": []}, {"policy": "a.py:p"}):
        Entry(method="another", scores=SCORES, nudge=0, details=details).write(tmp_path)
    assert read_entry(tmp_path).details == {"policy": "a.py:p"}
    assert read_entry(tmp_path).nudge == 0.0


@pytest.mark.parametrize(
    ("earlier", "stated", "expected"),
    [
        ({"learned_from": [], "looks": 0}, {}, {}),
        ({"learned_from": [], "looks": 0}, {"looks": 2}, {"looks": 2}),
        ({"looks": 20}, {}, {"looks": 20}),
        ({"looks": 20}, {"looks": 0}, {"looks": 20}),
        (
            {"learned_from": ["demonstrations"]},
            {"learned_from": ["demonstrations", "benchmark prior"]},
            {"learned_from": ["demonstrations", "benchmark prior"]},
        ),
    ],
)
def test_an_earlier_entry_does_not_flatter_a_later_one(
    tmp_path: Path, earlier: dict[str, Any], stated: dict[str, Any], expected: dict[str, Any]
) -> None:
    for details in (earlier, stated):
        Entry(method="mine", scores=SCORES, details=details).write(tmp_path)
    assert read_entry(tmp_path).details == expected


def test_a_full_disk_leaves_the_previous_entry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = Entry(method="mine", scores=SCORES, nudge=0.0)
    before.write(tmp_path)

    def full(*args: object) -> None:
        raise OSError(errno.ENOSPC, "no space left on device")

    for where in ("write_scores", "write_atomically"):
        with monkeypatch.context() as patch:
            patch.setattr(entries, where, full)
            with pytest.raises(OSError, match="no space"):
                Entry(method="mine", scores=SCORES[:1], nudge=1e-4).write(tmp_path)
        found = read_entry(tmp_path)
        assert (found.nudge, len(found.scores)) == (0.0, len(SCORES))


@pytest.mark.parametrize(
    "fields",
    [{"method": "x" * 201}, {"nudge": 5.0}, {"horizon": "soon"}, {"details": {"n": np.int64(3)}}],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path: Path, fields: dict[str, Any]) -> None:
    Entry(method="mine", scores=SCORES).write(tmp_path)
    with pytest.raises((ValueError, TypeError)):
        Entry(**{"method": "mine", "scores": SCORES[:1], **fields}).merged(tmp_path)
    with pytest.raises((ValueError, TypeError)):
        Entry(**{"method": "mine", "scores": SCORES[:1], **fields}).write(tmp_path)
    assert read_entry(tmp_path).scores == SCORES


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
    entry = Entry.of(policy, evaluation, method="m", details={})
    assert (entry.observation, entry.privileged) == expected


@pytest.mark.parametrize(
    ("action_space", "expected"), [("discrete", {}), ("continuous", {"action_space": "continuous"})]
)
def test_an_entry_names_other_actions_than_the_discrete_ones(
    action_space: ActionSpaceName, expected: dict[str, str]
) -> None:
    policy = ExpertPolicy(action_space=action_space)
    entry = Entry.of(policy, Evaluation.of([DEMO]), method="m", details={"authors": "us"})
    assert entry.details == {"authors": "us", **expected}


@pytest.mark.parametrize("missing", ["scores.csv", "entry.json"])
def test_half_an_entry_says_what_is_missing(tmp_path: Path, missing: str) -> None:
    Entry(method="mine", scores=SCORES).write(tmp_path)
    (tmp_path / missing).unlink()
    with pytest.raises(ScoresError, match=r"gone: expected a folder, found nothing"):
        read_entry(tmp_path / "gone")
    with pytest.raises(ScoresError, match=f"found no {missing}; `magical evaluate"):
        read_entry(tmp_path)


DEEP = '{"method": "x", "details": {"a": ' + "[" * 40 + "]" * 40 + "}}"


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "{}",
        '{"method": "x", "colour": 1}',
        '{"method": "x", "details": {"big": 1e999}}',
        DEEP,
        r'{"method": "\u001b[31mred"}',
        json.dumps({"method": "x" * 201}),
        '{"method": 3}',
        '{"method": " "}',
        '{"method": "m", "privileged": "no"}',
        '{"method": "m", "seed": -1}',
        '{"method": "m", "seed": true}',
        '{"method": "m", "details": []}',
        '{"method": "m", "nudge": 5.0}',
    ],
)
def test_a_damaged_entry_is_named(tmp_path: Path, text: str) -> None:
    Entry(method="mine", scores=SCORES).write(tmp_path)
    (tmp_path / "entry.json").write_text(text)
    with pytest.raises(ScoresError, match=r"entry\.json.*expected") as caught:
        read_entry(tmp_path)
    assert str(caught.value).isprintable()


@pytest.mark.posix
@pytest.mark.parametrize("name", ["scores.csv", "entry.json"])
def test_special_files_are_refused(tmp_path: Path, name: str) -> None:
    Entry(method="mine", scores=SCORES).write(tmp_path)
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises(ScoresError, match=rf"{name}: expected a readable file, found not a reg"):
        read_entry(tmp_path)


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
        Entry.of(BUILT_IN["noop"](), evaluation, method="mine", details={})


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
    Entry(method="mine", scores=scores, seed=seed).write(tmp_path)
    with pytest.raises(ScoresError, match=message) as caught:
        read_entry(tmp_path)
    assert str(tmp_path / "scores.csv") in str(caught.value)


def test_a_seeded_fuzz_of_entries_raises_nothing_else(tmp_path: Path) -> None:
    """Mutated files are read, or refused with `ScoresError`."""
    Entry(method="mine", scores=SCORES).write(tmp_path)
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
