"""Replays of trajectories, summed up by environment."""

from typing import Any

from magical.demos.replay import MeanReplay, Replay, mean_replays
from magical.envs import EnvId

DEMO, JITTER = EnvId("MakeLine", "Demo"), EnvId("MakeLine", "TestJitter")


def replayed(env_id: EnvId = DEMO, **more: Any) -> Replay:
    """A replay of an exact recording that scores 1 by the appendix's rule, 0.5 by the other."""
    right: dict[str, Any] = {
        "demonstrator": "human",
        "recorded": 0.5,
        "recorded_score": 1.0,
        "score": 1.0,
        "published_code_score": 0.5,
        "departure": 0.0,
    }
    return Replay(file="", env_id=env_id, **{**right, **more})


def test_means_are_of_each_environment_by_both_rules() -> None:
    departed = replayed(score=0.0, published_code_score=0.0, departure=0.3)
    unknown = replayed(JITTER, recorded_score=None, departure=None)
    assert mean_replays([unknown, replayed(), departed]) == [
        MeanReplay(
            env_id=DEMO,
            count=2,
            recorded=0.5,
            score=0.5,
            published_code_score=0.25,
            agree=1,
            published_replay=(0.46, 0.30),
            exact=1,
        ),
        MeanReplay(
            env_id=JITTER,
            count=1,
            recorded=0.5,
            score=1.0,
            published_code_score=0.5,
            agree=1,
            published_replay=None,
            exact=None,
        ),
    ]
    (mixed,) = mean_replays([replayed(), replayed(demonstrator="expert")])
    assert mixed.published_replay is None
