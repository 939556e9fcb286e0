"""Exceptions of a task in a worker: reported by class name."""

from collections.abc import Callable

import pytest

from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidScoreError, WorkerError

Misbehave = Callable[[str], str]
ENV_ID = "magical/Misbehaving-Demo-v0"


def raised(env_id: str, workers: int = 1) -> Exception:
    """What the last step of an episode raises."""
    envs = MagicalVectorEnv([env_id], workers, "state", horizon=1)
    envs.reset(seed=0)
    with pytest.raises(Exception) as caught:  # noqa: PT011  (each test names the class)
        envs.step([0])
    envs.reset(seed=0)  # the worker goes on
    envs.close()
    return caught.value


def test_exceptions_are_named(misbehave: Misbehave) -> None:
    found = raised(misbehave("raise Unprintable(1)"))
    assert type(found) is WorkerError
    assert str(found) == "misbehaving_task.Unprintable: <exception str() failed>"
    assert found.__notes__ == [f"in environment 0 ({ENV_ID})"]
    assert "score_fn" in str(found.__cause__)


@pytest.mark.parametrize("value", ["float('nan')", "float('inf')", "-0.1", "1.5", "None", "'1'"])
def test_scores_are_numbers_from_0_to_1(misbehave: Misbehave, value: str) -> None:
    env_id = misbehave(f"return {value}")
    env = MagicalEnv("Misbehaving", "Demo", observation="state", horizon=2)
    env.reset(seed=0)
    env.step(0)
    expected = f"Misbehaving.*from 0 to 1, found {eval(value)!r}"  # noqa: S307
    with pytest.raises(InvalidScoreError, match=expected):
        env.step(0)
    for workers in (0, 1):
        found = raised(env_id, workers)
        assert type(found) is InvalidScoreError
        assert found.__notes__ == [f"in environment 0 ({env_id})"]
