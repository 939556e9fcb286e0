"""Whether entries follow the protocol."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from magical.evaluation import Entry
from magical.evaluation.policy import FunctionPolicy, observed
from magical.evaluation.protocol import NUDGE, ROLLOUTS
from magical.observe import Observation, PixelSpec
from magical.report.found import Found, Result, Skipped
from magical.report.leaderboard import check_entries, faults
from magical.tasks import get_task
from tests.report.conftest import make_entry

LEARNED = {"learned_from": ["demonstrations"]}


def entry(score: float = 0.5, **fields: Any) -> Entry:
    """An entry on one task with which nothing is wrong."""
    variants = get_task("MoveToRegion").variants
    right: dict[str, Any] = {
        "observation": "LoRes4E",
        "nudge": NUDGE,
        "record": {"learned_from": ["demonstrations"]},
    }
    scores = {f"MoveToRegion-{variant}": [score] * ROLLOUTS for variant in variants}
    return make_entry("m", scores, **(right | fields))


def test_a_right_entry_has_no_faults() -> None:
    assert faults(entry()) == []
    assert faults(entry(record={"learned_from": []})) == []
    assert faults(entry(record={"learned_from": [], "test_evaluations": 0})) == []
    assert faults(entry(version="0.1.0")) == []  # whose scores are those of 1.0
    assert faults(entry(version="0.2.0")) != []


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"horizon": "41"}, "horizon 41"),
        ({"nudge": 0.0}, "nudge 0, expected 1e-09"),
        ({"seed": 1}, "set 1 of fixed seeds"),
        ({"record": {}}, "expected learned_from in the record"),
        (
            {"record": {"learned_from": [], "updates": (25, 600)}},
            "unfinished (25 of 600 updates)",
        ),
        ({"observation": ""}, "observation '' is unknown here"),
        ({"observation": "State"}, "observation 'State' is unknown here"),
        ({"observation": "state_vector:SPEC"}, "'state_vector:SPEC' is unknown here"),
        ({"observation": '{"size": 1e9}'}, "observation: size: expected int"),
        ({"observation": '{"parts": []}'}, "parts: expected each view once"),
        ({"version": ""}, "made by version (not stated)"),
        ({"version": "99.1.0"}, "made by version 99.1.0"),
    ],
)
def test_every_fault_is_named(fields: dict[str, Any], message: str) -> None:
    (found,) = faults(entry(**fields))
    assert message in found


@pytest.mark.parametrize(("trained", "refused"), [("LoRes4E", False), ("state", True)])
def test_what_a_policy_was_shown_is_what_its_run_says(
    tmp_path: Path, trained: str, refused: bool
) -> None:
    (tmp_path / "config.json").write_text(json.dumps({"observation": trained}))
    _, rejected = check_entries(Found([Result(tmp_path, entry(), tmp_path)]))
    reasons = [reason for item in rejected for reason in item.reasons]
    assert reasons == ["observation LoRes4E, but its run was trained on state"] * refused


@pytest.mark.parametrize(
    "observation", [{"parts": [["allo", 2]], "size": 64}, PixelSpec(size=32), "raw", None]
)
def test_images_of_any_settings_can_be_ranked(observation: Observation) -> None:
    named, privileged = observed(FunctionPolicy(print), observation, get_task("MoveToRegion"))
    assert faults(entry(observation=named, privileged=privileged)) == []


def test_missing_variants_and_rollouts_are_named() -> None:
    variants = [v for v in get_task("MoveToRegion").variants if v != "TestAll"]
    scores = {f"MoveToRegion-{variant}": [0.5] * 10 for variant in variants}
    found = faults(make_entry("m", scores, observation="LoRes4E", nudge=NUDGE, record=LEARNED))
    assert found[0] == f"10 rollouts of each environment, expected {ROLLOUTS}"
    assert found[1].startswith("MoveToRegion without All")


def check(*entries: Entry) -> list[tuple[str, str]]:
    """The folders of rejected entries, which are numbers, and the first reason of each."""
    results = [Result(Path(str(number)), entry) for number, entry in enumerate(entries)]
    accepted, rejected = check_entries(Found(results))
    assert len(accepted) + len(rejected) == len(entries)
    return [(item.folder, item.reasons[0]) for item in rejected]


def test_runs_of_a_method_agree() -> None:
    first = entry(0.1)
    assert check(first, entry(0.2)) == []
    for other, words in (
        (entry(0.2, observation="LoRes4A"), "LoRes4A, but 0 of the same method has LoRes4E"),
        (entry(0.2, privileged=True), "privileged: True"),
        (
            entry(0.2, action_space="continuous"),
            "action space: continuous",
        ),
        (entry(0.2, record={"learned_from": []}), "learned from: nothing"),
    ):
        ((folder, reason),) = check(first, other)
        assert folder == "1"
        assert words in reason
        assert check(first, replace(other, method="another")) == []


def test_a_run_counts_once() -> None:
    telling = [row._replace(score=row.rollout / ROLLOUTS) for row in entry().scores]
    first = replace(entry(), scores=telling)
    ((folder, reason),) = check(first, first)
    assert folder == "1"
    assert reason.startswith("the same run as 0")
    backwards = replace(first, scores=list(reversed(telling)))
    assert [folder for folder, _ in check(first, backwards)] == ["1"]
    assert check(first, replace(first, method="another")) == []
    assert check(entry(), entry()) == []  # runs that score alike nearly everywhere


def test_a_training_seed_counts_once() -> None:
    def seeded(score: float, seed: int) -> Entry:
        return entry(score, record={**LEARNED, "training_seed": seed})

    assert check(seeded(1.0, 0), seeded(1.0, 1)) == []  # both always succeed
    assert [folder for folder, _ in check(seeded(1.0, 0), seeded(0.5, 0))] == ["1"]


def test_a_rejected_entry_does_not_stand_against_others() -> None:
    assert [folder for folder, _ in check(entry(horizon="41"), entry())] == ["0"]


def test_damaged_entries_are_listed() -> None:
    accepted, rejected = check_entries(Found([], [Skipped(Path("x"), "damaged")]))
    assert accepted == []
    assert [(item.folder, item.method, item.reasons) for item in rejected] == [
        ("x", "", ["damaged"])
    ]
