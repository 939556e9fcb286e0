"""What a page may send: every message, nothing else, not too often."""

import json
import random
import string
from typing import Any

import pytest

from magical.envs import EnvId
from magical.envs.keys import Control
from magical.envs.seeds import FIRST_EVALUATION_SEED
from magical.errors import MessageError
from magical_play.messages import (
    MAX_BYTES,
    Discard,
    HandBack,
    Keep,
    Keys,
    ListQuery,
    Pause,
    Restart,
    Resume,
    Show,
    Start,
    Watch,
    parse_message,
)
from magical_play.security import RateLimit

ENV = "magical/FindDupe-TestAll-v0"
VALID: dict[str, tuple[dict[str, Any], object]] = {
    "keys": (
        {"held": ["grip", "left"], "seen": 7},
        Keys(frozenset({Control.LEFT, Control.GRIP}), 7),
    ),
    "start": ({"env_id": ENV, "seed": 3}, Start(EnvId("FindDupe", "TestAll"), 3)),
    "restart": ({}, Restart()),
    "pause": ({}, Pause()),
    "resume": ({}, Resume()),
    "view": ({"view": "both"}, Show("both")),
    "keep": ({"demonstrator": " Ada\u3000\u200d\U0001f52c "}, Keep("Ada\u3000\u200d\U0001f52c")),
    "discard": ({}, Discard()),
    "watch": ({"policy": 1}, Watch(1)),
    "hand_back": ({}, HandBack()),
}


@pytest.mark.parametrize("kind", VALID)
def test_messages_are_parsed(kind: str) -> None:
    fields, message = VALID[kind]
    assert parse_message(json.dumps({"type": kind, **fields})) == message


def test_presets_are_left_out_and_seeds_may_be_missing() -> None:
    text = json.dumps({"type": "start", "env_id": "FindDupe-Demo-LoRes4E-v0", "seed": None})
    assert parse_message(text) == Start(EnvId("FindDupe", "Demo"), None)


@pytest.mark.parametrize(
    "fields",
    [
        {"type": "keys", "held": ["up"], "seen": 0},
        {"type": "keys", "held": ["left"] * 6, "seen": 0},
        {"type": "keys", "held": "left", "seen": 0},
        {"type": "keys", "held": [["left"]], "seen": 0},
        {"type": "keys", "held": [], "seen": -1},
        {"type": "keys", "held": [], "seen": True},
        {"type": "keys", "held": [], "seen": 1e300},
        {"type": "keys", "held": []},
        {"type": "start", "env_id": "magical/MoveToMoon-Demo-v0", "seed": 0},
        {"type": "start", "env_id": ["magical/MoveToRegion-Demo-v0"], "seed": 0},
        {"type": "start", "env_id": ENV, "seed": FIRST_EVALUATION_SEED},
        {"type": "start", "env_id": ENV, "seed": "0"},
        {"type": "view", "view": "side"},
        {"type": "view", "view": {}},
        {"type": "keep", "demonstrator": "  "},
        {"type": "keep", "demonstrator": "a" * 101},
        {"type": "keep", "demonstrator": "a\nb"},
        {"type": "pause", "seconds": 3},
        {"type": "watch"},
        {"type": "watch", "policy": "0"},
        {"type": "watch", "policy": -1},
        {"type": "watch", "policy": 10**7},
        {"type": "watch", "policy": True},
        {"type": "hand_back", "policy": 0},
        {"type": ["pause"]},
        {"type": "quit"},
        {},
    ],
)
def test_other_messages_are_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(MessageError):
        parse_message(json.dumps(fields))


def test_a_long_message_is_refused_before_it_is_parsed() -> None:
    text = json.dumps({"type": "pause"})
    assert parse_message(text + " " * (MAX_BYTES - len(text))) == Pause()
    with pytest.raises(MessageError, match="at most 1024 bytes"):
        parse_message(text + " " * (MAX_BYTES - len(text) + 1))


def malformed(rng: random.Random) -> str:
    """A random text that is no message: noise, other JSON, or a message with a part changed."""
    kind = rng.choice(list(VALID))
    text = json.dumps({"type": kind, **VALID[kind][0]})
    choice = rng.randrange(5)
    if choice == 0:
        return "".join(rng.choices(string.printable + "\0é\U0001f916", k=rng.randrange(200)))
    if choice == 1:
        return "[" * rng.randrange(1, 1000)
    if choice == 2:
        return text[: rng.randrange(len(text))]
    if choice == 3:
        return json.dumps(rng.choice([[], 3, "x", None, {"type": rng.random()}, {"keys": text}]))
    return text[:-1] + f', "{rng.choice(string.ascii_letters)}": {rng.randrange(10**30)}}}'


def test_lists_are_of_any_task_that_can_be_looked_up() -> None:
    assert ListQuery("rollouts", "Generated0004", 0).task == "Generated0004"
    with pytest.raises(ValueError, match="found 'MoveToMoon'"):
        ListQuery("rollouts", "MoveToMoon", 0)


def test_five_thousand_malformed_messages_are_refused() -> None:
    rng = random.Random(0)
    for _ in range(5000):
        with pytest.raises(MessageError) as raised:
            parse_message(malformed(rng))
        assert len(str(raised.value)) < 1000


def test_messages_are_limited_in_rate() -> None:
    limit = RateLimit(rate=10.0, burst=20.0, now=100.0)
    assert [limit.allows(100.0) for _ in range(25)] == [True] * 20 + [False] * 5
    assert [limit.allows(100.55) for _ in range(10)] == [True] * 5 + [False] * 5
    assert sum(limit.allows(1000.0) for _ in range(100)) == 20
