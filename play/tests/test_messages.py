"""What a page may send: every message, nothing else."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magical.envs import EnvId
from magical.envs.keys import Control
from magical.envs.seeds import FIRST_EVALUATION_SEED
from magical_play import messages as m
from magical_play.messages import MessageError, parse_message

START = {"env_id": "magical/FindDupe-TestAll-LoRes4E-v0", "seed": 3, "policy": 1}
VALID = {
    "keys": (
        {"held": ["grip", "left"], "seen": 7},
        m.Keys(frozenset({Control.LEFT, Control.GRIP}), 7),
    ),
    "start": (START, m.Start(EnvId("FindDupe", "TestAll"), 3, 1)),
    "press": ({"button": "hand_back"}, m.Press("hand_back")),
    "show": ({"view": "both", "speed": 0.5}, m.Show("both", 0.5)),
    "keep": ({"demonstrator": " Ada\u3000\u200d\U0001f52c "}, m.Keep("Ada\u3000\u200d\U0001f52c")),
    "watch": ({"dataset": 0, "episode": 3}, m.Watch(0, 3)),
    "seek": ({"step": 4}, m.Seek(4)),
}


@pytest.mark.parametrize("kind", VALID)
def test_messages_are_parsed(kind):
    fields, message = VALID[kind]
    assert parse_message(json.dumps({"type": kind, **fields})) == message


@pytest.mark.parametrize(
    "fields",
    [
        {"type": "keys", "held": ["up"], "seen": 0},
        {"type": "keys", "held": ["left"] * 6, "seen": 0},
        {"type": "keys", "held": [], "seen": -1},
        {"type": "keys", "held": []},
        {"type": "start", **START, "env_id": "magical/MoveToMoon-Demo-v0"},
        {"type": "start", **START, "seed": FIRST_EVALUATION_SEED},
        {"type": "start", **START, "policy": -1},
        {"type": "press", "button": "take_question"},
        {"type": "press", "button": "pause", "seconds": 3},
        {"type": "show", "view": "side", "speed": 1},
        {"type": "show", "view": "ego", "speed": 0},
        {"type": "keep", "demonstrator": "  "},
        {"type": "keep", "demonstrator": "a" * 101},
        {"type": "keep", "demonstrator": "a\nb"},
        {"type": "watch", "dataset": "../demos", "episode": 0},
        {"type": "seek", "step": 10**30},
        {"type": "quit"},
    ],
)
def test_other_messages_are_refused(fields):
    with pytest.raises(MessageError):
        parse_message(json.dumps(fields))


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=4,
)


@settings(deadline=None)
@given(
    st.text()
    | st.integers(1, 1000).map(lambda depth: "[" * depth)
    | PLAIN.map(json.dumps)
    | st.tuples(st.sampled_from(list(VALID)), st.dictionaries(st.text(min_size=1), PLAIN)).map(
        lambda drawn: json.dumps({**VALID[drawn[0]][0], **drawn[1], "type": drawn[0]})
    )
)
def test_any_text_is_a_message_or_refused_in_a_line(text):
    found = ""
    try:
        parse_message(text)
    except MessageError as error:
        found = str(error)
    assert len(found) < 1000
