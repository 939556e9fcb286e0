"""Running a sample of an entry's rollouts again."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magical import cli
from magical.envs import EnvId
from magical.errors import PolicyError, ScoresError
from magical.evaluation import (
    Entry,
    Evaluation,
    FunctionPolicy,
    Policy,
    RandomPolicy,
    Record,
    RolloutScore,
    environments,
    evaluate,
    load_policy,
    read_entry,
)
from magical.evaluation.policy import Actions
from magical.evaluation.rollouts import Verification, is_elsewhere, roll_out, verify
from magical.observe import Observation
from magical.runs import machine, versions
from tests.entries import entry_of

IDS = environments(["MoveToRegion"], ["Demo", "Layout", "All"])
DEMO = EnvId("MoveToRegion", "Demo")


class BatchSizes(RandomPolicy):
    """Depends on the size of the batch, as a network's arithmetic may."""

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        return (super().act(observations, env_ids, rng) + len(env_ids)) % 18


@pytest.mark.parametrize(
    ("policy", "ids", "rollouts", "rounds"),
    [(BatchSizes(), IDS, 23, (12, 11)), (load_policy("expert"), IDS[:1], 12, (10, 2))],
)
def test_rounds_are_batches(policy: Policy, ids: Any, rollouts: int, rounds: Any) -> None:
    evaluation = Evaluation.of(ids, rollouts=rollouts, horizon=12)
    scores = roll_out(policy, evaluation, workers=0)
    entry = Entry.of(policy, evaluation, method="m", scores=scores, record=Record())
    rngs = map(np.random.default_rng, range(9))
    found = [verify(entry, policy, rng=rng, workers=0) for rng in rngs]
    assert all(each.again == each.recorded for each in found)
    assert {len(each.again) for each in found} == {count * len(ids) for count in rounds}


@pytest.fixture(scope="module")
def entry() -> Entry:
    scores = evaluate(RandomPolicy(), IDS, rollouts=30, horizon=20, nudge=1e-4, seed=2, workers=0)
    return entry_of("m", scores, observation="state", horizon="20", nudge=1e-4, seed=2)


def test_the_scores_of_the_same_policy_are_confirmed(entry: Entry) -> None:
    rng = np.random.default_rng(0)
    found = verify(entry, RandomPolicy(), rng=rng, workers=0)
    assert found.confirmed
    assert found.equal == len(found.recorded) == 3 * 15
    assert (found.total, found.share) == (90, 0.5)
    assert set(found.by_environment()) == set(IDS)
    everything = verify(entry, RandomPolicy(), rounds=99, rng=rng, workers=0)
    assert sorted(everything.again) == sorted(entry.scores)


def by_sight(observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Any:
    return observations.reshape(len(env_ids), -1).astype(np.int64).sum(axis=1) % 18


@pytest.mark.parametrize("observation", ["LoRes4A", {"parts": (("allo", 2),), "size": 48}])
def test_a_policy_is_shown_again_what_it_was_shown(observation: Observation) -> None:
    policy, rng = FunctionPolicy(by_sight), np.random.default_rng(0)
    evaluation = Evaluation.of(IDS[:1], rollouts=2, horizon=20, observation=observation)
    shown = roll_out(policy, evaluation, workers=0)
    made = Entry.of(policy, evaluation, method="m", scores=shown, record=Record())
    found = verify(made, policy, rng=rng, workers=0)
    assert found.confirmed
    assert found.exact
    assert not verify(made, policy, rng=rng, elsewhere=True, workers=0).exact


def test_the_scores_of_another_policy_are_not(entry: Entry) -> None:
    perfect = [row._replace(score=1.0, published_code_score=1.0) for row in entry.scores]
    rng = np.random.default_rng(0)
    better = replace(entry, scores=perfect)
    found = verify(better, RandomPolicy(), rng=rng, elsewhere=True, workers=0)
    assert found.exact  # without a network, on every machine
    assert not found.confirmed
    assert not replace(found, exact=False).confirmed
    assert found.mean_changes()[0].high < 0.0


def rows(*scores: float, env_id: EnvId = DEMO) -> list[RolloutScore]:
    return [RolloutScore(env_id, i, i, score, score) for i, score in enumerate(scores)]


def test_changes_have_an_interval_and_count_unless_all_must_be_equal() -> None:
    found = Verification(rows(0, 0, 0, 0), rows(0, 0, 0, 1), exact=False, total=4)
    # The changes' standard deviation is 1/2, that of their mean 1/4; t(3) = 3.182446.
    half = 3.182446 / 4
    assert found.mean_changes()[0] == pytest.approx((0.25, 0.25 - half, 1.0))
    assert (found.equal, found.confirmed) == (3, True)
    assert not replace(found, exact=True).confirmed


def swapped(good: list[float], bad: list[float], count: int = 2) -> Any:
    """What is claimed and found if environments' scores are swapped: the mean does not change."""
    ids, scores = environments(["MoveToRegion", "MoveToCorner"])[:count], (good, bad)
    now = [row for k, i in enumerate(ids) for row in rows(*scores[k % 2], env_id=i)]
    return [row for k, i in enumerate(ids) for row in rows(*scores[1 - k % 2], env_id=i)], now


HALF = rows(*[0.5] * 8)


@pytest.mark.parametrize(
    ("claimed", "now", "confirmed"),
    [
        (HALF, HALF, True),
        (*swapped([1.0] * 7 + [0.0], [1.0] + [0.0] * 7), False),
        (*swapped([1.0], [0.0]), False),  # one rollout tells nothing
        # In each environment the mean change, 5/8, is 3.42 times its standard error: the more
        # environments, the more often one changes so by chance.
        (*swapped([1.0] * 5 + [0.0] * 3, [0.0] * 8), False),
        (*swapped([1.0] * 5 + [0.0] * 3, [0.0] * 8, 12), True),
        # A change by one rule is not cancelled by the other.
        (
            [row._replace(score=0.9, published_code_score=row.rollout % 2 / 2) for row in HALF],
            HALF,
            False,
        ),
    ],
)
def test_elsewhere_environments_and_rules_do_not_cancel(
    claimed: list[RolloutScore], now: list[RolloutScore], confirmed: bool
) -> None:
    assert Verification(claimed, now, exact=False, total=len(now)).confirmed == confirmed


def test_rules_that_are_the_same_give_the_same_score_in_every_row(entry: Entry) -> None:
    *others, last = entry.scores
    changed = replace(entry, scores=[*others, last._replace(published_code_score=0.123)])
    with pytest.raises(ScoresError, match="rollout 29: expected equal scores by both rules"):
        verify(changed, RandomPolicy(), rng=np.random.default_rng(), workers=0)


def test_another_kind_of_policy_is_refused(entry: Entry) -> None:
    rng = np.random.default_rng(0)
    policy = FunctionPolicy(print, SimpleNamespace(observation="LoRes4E"))
    with pytest.raises(PolicyError, match="privileged"):
        verify(entry, policy, rng=rng)
    how = replace(entry.evaluated, observation="LoRes4A", privileged=False)
    with pytest.raises(PolicyError, match="LoRes4A"):
        verify(replace(entry, evaluated=how), policy, rng=rng)


HERE = {"name": "a", "processor": "p", "cores": "2"}


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ({"machine": {**HERE, "name": "b"}, "versions": {"numpy": "1"}}, False),
        ({"machine": HERE, "versions": {"numpy": "2"}}, True),
        ({"machine": HERE, "versions": {"numpy": "1", "plugin": "1"}}, True),
        ({"machine": {**HERE, "processor": "q"}}, False),
        ({"versions": {"numpy": "2"}}, False),
    ],
)
def test_another_machine_counts_only_where_it_is_stated(
    stated: dict[str, Any], expected: bool
) -> None:
    assert is_elsewhere(Record(**stated), HERE, {"numpy": "1", "python": "3"}) == expected


def test_the_command_confirms_or_exits_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["--task", "MoveToRegion", "--variants", "Demo", "--rollouts", "70"]
    options = ["--workers", "0", "--horizon", "2", "--noise", "1e-9"]
    cli.main(["evaluate", "random", *argv, *options, "--out", str(tmp_path)])
    record = read_entry(tmp_path).record
    assert (record.policy, record.learned_from) == ("random", ())
    assert (record.machine, record.versions) == (machine(), versions())
    capsys.readouterr()
    verify = ["verify", str(tmp_path), "--workers", "0", "--seed", "1"]
    assert cli.main([*verify, "--json"]) == 0
    out = capsys.readouterr().out
    assert "35 of 70 rollouts run again: one altered score is found with probability 0.50" in out
    assert '"total": 70, "equal": 35' in out
    assert cli.main([*verify, "--rounds", "2"]) == 0
    assert "all 70 rollouts run again\nconfirmed: 70 of 70" in capsys.readouterr().out
    scores = tmp_path / "scores.csv"
    scores.write_text(scores.read_text().replace(",0.0,0.0", ",1.0,1.0"))
    assert cli.main(verify) == 1
    assert "not confirmed" in capsys.readouterr().out


def test_code_that_an_entry_names_is_not_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], entry: Entry
) -> None:
    (tmp_path / "bad.py").write_text("raise SystemExit('run')\n")
    record = Record(policy=f"{tmp_path / 'bad.py'}:policy")
    replace(entry, record=record).write(tmp_path)
    assert cli.main(["verify", str(tmp_path)]) == 1
    err = capsys.readouterr().err
    assert "expected a run folder or one of random, noop, expert" in err
    assert "by --policy" in err
