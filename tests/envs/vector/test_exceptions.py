"""Exceptions of a task in a worker: reported by class name, with bounded text."""

import json
from collections.abc import Callable

import pytest

from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidScoreError, WorkerError
from magical.processes import describe, rebuild

Misbehave = Callable[[str], str]
LONGEST = 10_000  # characters of a message with its notes


def raised(env_id: str, workers: int = 1) -> Exception:
    """What the last step of an episode raises."""
    envs = MagicalVectorEnv([env_id], workers, "state", horizon=1)
    envs.reset(seed=0)
    with pytest.raises(Exception) as caught:  # noqa: PT011  (each test names the class)
        envs.step([0])
    envs.reset(seed=0)  # the worker goes on
    envs.close()
    return caught.value


@pytest.mark.parametrize(
    ("body", "error", "text"),
    [
        (
            'raise ExceptionGroup("two", [ValueError(1), KeyError(2)])',
            WorkerError,
            "ExceptionGroup",
        ),
        ("raise Unprintable(1)", WorkerError, "Unprintable: 1"),
        ("raise ValueError(Unprintable(1))", ValueError, "Unprintable"),
        ("raise ValueError('x' * 50_000_000)", ValueError, "characters left out"),
        ("raise ValueError(10 ** 100_000)", ValueError, "integer of"),
        ("raise ValueError(doubled(60))", ValueError, "tuple of 2"),
        ("raise ValueError('\\ud800')", ValueError, "\ud800"),
        ("raise UnicodeDecodeError('utf-8', b'x', 0, 1, 'bad')", WorkerError, "UnicodeDecodeError"),
        ("raise FileNotFoundError(2, 'not there', 'name')", FileNotFoundError, "name"),
    ],
)
def test_any_exception_is_named(
    misbehave: Misbehave, body: str, error: type[Exception], text: str
) -> None:
    found = raised(misbehave(body))
    assert type(found) is error
    assert text in str(found)
    assert len(str(found)) + sum(map(len, found.__notes__)) < LONGEST
    assert "score_fn" in str(found.__cause__)


@pytest.mark.parametrize("notes", ["5", "[5, b'x', 'y' * 50_000_000]"])
@pytest.mark.parametrize("workers", [0, 1])
def test_notes_that_are_no_text(misbehave: Misbehave, notes: str, workers: int) -> None:
    body = f"error = ValueError('no score'); error.__notes__ = {notes}; raise error"
    found = raised(misbehave(body), workers)
    assert type(found) is ValueError
    assert found.args == ("no score",)


def test_descriptions_are_small() -> None:
    error = ValueError(*["x" * 100_000] * 100)
    error.__notes__ = ["y" * 100_000] * 100
    text = json.dumps(describe(error))
    assert len(text) < 100_000
    assert type(rebuild(json.loads(text))) is ValueError


def test_a_class_of_the_same_name_as_a_built_in_one() -> None:
    described = describe(type("ValueError", (Exception,), {"__module__": "elsewhere"})("text"))
    found = rebuild(described)
    assert type(found) is WorkerError
    assert str(found) == "ValueError: text"


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
