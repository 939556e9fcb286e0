"""Best, median and worst rollouts."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.envs import EnvId, parse_env_id
from magical.errors import PolicyError
from magical.evaluation import (
    Evaluation,
    NoopPolicy,
    Policy,
    RandomPolicy,
    RolloutScore,
    environments,
    evaluate,
)
from magical.evaluation.rollouts import roll_out
from magical.report.figures import extremes, record_reels, record_rollouts
from magical.report.found import Result
from tests.entries import entry_of

DEMO = EnvId("MoveToRegion", "Demo")


def rows(*scores: float) -> list[RolloutScore]:
    return [RolloutScore(DEMO, i, i, score, 0.0) for i, score in enumerate(scores)]


def test_extremes_are_chosen_by_score_then_number() -> None:
    chosen = {name: row.rollout for name, row in extremes(rows(0.5, 1.0, 0.0, 1.0, 0.2))}
    assert chosen == {"best": 3, "median": 0, "worst": 2}
    assert [(name, row.rollout) for name, row in extremes(rows(1.0, 1.0))] == [("every rollout", 0)]
    assert [(name, row.rollout) for name, row in extremes(rows(0.0, 1.0))] == [
        ("best", 1),
        ("median", 0),
    ]


@pytest.mark.parametrize(
    ("settings", "every", "frames"),
    [
        ({}, 7, 7),  # the first, steps 7 to 35, and the last step, 40
        ({"horizon": 20, "nudge": 1e-4}, 1, 21),
    ],
)
def test_rollouts_are_recorded_as_they_were_evaluated(
    settings: dict[str, Any], every: int, frames: int
) -> None:
    ids = environments(["MoveToRegion"], ["Demo", "All"])
    evaluation = Evaluation.of(ids, rollouts=3, **settings)
    scores = roll_out(RandomPolicy(), evaluation, workers=0)
    rollouts = [(row.env_id, row.rollout) for row in scores]
    clips = record_rollouts(RandomPolicy(), evaluation, rollouts, size=32, every=every)
    assert [clip.score for clip in clips] == [row.score for row in scores]
    assert all(clip.frames.shape == (frames, 32, 32, 3) for clip in clips)
    if "nudge" not in settings:
        for clip, row in zip(clips, scores, strict=True):
            env = gymnasium.make(row.env_id, observation={"parts": [["allo", 1]], "size": 32})
            np.testing.assert_array_equal(clip.frames[0], env.reset(seed=row.seed)[0])
            assert (clip.frames[0] != clip.frames[-1]).any()


def result(policy: Policy, method: str, variant: str = "Demo") -> Result:
    ids = [parse_env_id(f"magical/MoveToRegion-{variant}-v0")]
    scores = evaluate(policy, ids, rollouts=3, workers=0)
    return Result(Path(method), entry_of(method, scores))


def test_a_reel_has_a_clip_of_every_variant() -> None:
    shown, notes = record_reels([result(NoopPolicy(), "w")], lambda _: NoopPolicy(), 1)
    assert notes == []
    ((uri, caption),) = shown[0].clips
    assert uri.startswith("data:image/webp")
    assert caption == "Demo, every rollout: 0.00"


def test_what_is_not_shown_is_said() -> None:
    results = [result(NoopPolicy(), name) for name in ("a", "b", "c")]

    def load(result: Result) -> Policy:
        if result.entry.method == "a":
            raise PolicyError("no such policy")
        return NoopPolicy()

    shown, notes = record_reels(results, load, 2)
    assert [reel.title for reel in shown] == ["b on MoveToRegion"]
    assert notes[0] == "a on MoveToRegion: no such policy"
    assert "c on MoveToRegion" in notes[1]


def test_a_score_that_is_not_the_recorded_one_is_said() -> None:
    entry = entry_of("m", rows(0.5, 0.5))
    shown, _ = record_reels([Result(Path("m"), entry)], lambda _: NoopPolicy(), 1)
    assert shown[0].clips[0][1] == "Demo, every rollout: 0.00 (recorded: 0.50)"


def test_of_several_runs_the_median_one_is_shown() -> None:
    results = [Result(Path(str(s)), entry_of("m", rows(s))) for s in (0.9, 0.1, 0.5)]
    loaded = []

    def load(result: Result) -> Policy:
        loaded.append(result.folder.name)
        return NoopPolicy()

    record_reels(results, load, 5)
    assert loaded == ["0.5"]
