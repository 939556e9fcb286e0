"""What the page may send over the socket; the types validate it."""

import unicodedata
from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import force_setattr

from magical.envs import parse_env_id
from magical.envs.keys import Control
from magical.envs.seeds import FIRST_EVALUATION_SEED
from magical.errors import MagicalError
from magical.files import parse_json
from magical.messages import quoted

MAX_BYTES = 1024  # of a message
MAX_NAME = 100  # characters of a demonstrator's name

# Unicode categories not allowed in names: controls, surrogates, line and paragraph separators.
_CONTROLS = frozenset({"Cc", "Cs", "Zl", "Zp"})
Number = Annotated[int, Meta(ge=0, lt=10**9)]


class MessageError(MagicalError, ValueError):
    """A message that is not in the documented format, or cannot be followed now."""


class _Message(Struct, frozen=True, forbid_unknown_fields=True, tag_field="type", tag=str.lower):
    """A JSON object whose field `type` names the class."""


class Keys(_Message, frozen=True):
    """The controls that are held, and the newest frame; sent for every key and every frame."""

    held: Annotated[frozenset[Control], Meta(max_length=len(Control))]
    seen: Annotated[int, Meta(ge=0, le=1 << 53)]  # all integers that JavaScript represents


class Start(_Message, frozen=True):
    """Start an episode; without a seed, in a newly sampled scene; without a policy, to play it."""

    env_id: str
    # Evaluation scenes must not be demonstrated (docs/protocol.md).
    seed: Annotated[int, Meta(ge=0, lt=FIRST_EVALUATION_SEED)] | None
    policy: Number | None

    def __post_init__(self) -> None:
        force_setattr(self, "env_id", parse_env_id(self.env_id).without_preset)


class Press(_Message, frozen=True):
    """What a button or key of the page asks for."""

    button: Literal["restart", "pause", "resume", "discard", "hand_back"]


class Show(_Message, frozen=True):
    """How to show episodes; at speed 1, eight steps of a recorded one take one second."""

    view: Literal["allo", "ego", "both"]
    speed: Annotated[float, Meta(ge=0.125, le=16)]


class Keep(_Message, frozen=True):
    """Store the finished episode."""

    demonstrator: Annotated[str, Meta(max_length=MAX_NAME)]

    def __post_init__(self) -> None:
        force_setattr(self, "demonstrator", self.demonstrator.strip())
        kinds = map(unicodedata.category, self.demonstrator)
        if not self.demonstrator or not _CONTROLS.isdisjoint(kinds):
            raise ValueError(
                f"demonstrator: expected a printable name, found {quoted(self.demonstrator)}"
            )


class Watch(_Message, frozen=True):
    """Watch an episode of a dataset, both by their numbers; without one, list the episodes."""

    dataset: Number
    episode: Number | None


class Seek(_Message, frozen=True):
    """Go to a step of the watched episode."""

    step: Number


Message = Keys | Start | Press | Show | Keep | Watch | Seek


def parse_message(text: str) -> Message:
    """Parse a message; raises `MessageError` if it is invalid or too long."""
    content = text.encode(errors="replace")
    if len(content) > MAX_BYTES:
        raise MessageError(f"message: expected at most {MAX_BYTES} bytes, found {len(content)}")
    message: Message = parse_json(content, Message, "message", MessageError)
    return message
