"""What the page may send: messages over the socket, requests over HTTP; types validate them."""

import re
import unicodedata
from collections.abc import Mapping
from typing import Annotated, Literal, TypeVar

from msgspec import Meta, Struct
from msgspec.structs import force_setattr

from magical.envs.ids import parse_env_id
from magical.envs.keys import Control
from magical.envs.seeds import FIRST_EVALUATION_SEED
from magical.errors import MessageError
from magical.messages import quoted
from magical.scene.vocabulary import View
from magical.tasks import TASKS
from magical.untrusted import convert, parse_json

MAX_BYTES = 1024  # of a message, and of a request's body
MAX_NAME = 100  # characters of a demonstrator's name
MAX_FRAMES = 16  # in one answer
PAGE_LENGTH = 100  # episodes in one answer

PAGE_VIEWS: Mapping[str, tuple[View, ...]] = {
    "allo": (View.ALLO,),
    "ego": (View.EGO,),
    "both": (View.EGO, View.ALLO),
}

ViewName = Literal["allo", "ego", "both"]
Number = Annotated[int, Meta(ge=0, le=10**9)]
PolicyNumber = Annotated[int, Meta(ge=0, le=10**6)]
# JavaScript's numbers represent all integers up to this limit.
FrameNumber = Annotated[int, Meta(ge=0, le=1 << 53)]
# Evaluation scenes must not be demonstrated (docs/protocol.md).
Seed = Annotated[int, Meta(ge=0, lt=FIRST_EVALUATION_SEED)]
SourceKey = Annotated[str, Meta(min_length=1, max_length=20)]


# Unicode categories not allowed in names: controls, surrogates, line and paragraph separators.
_CONTROLS = frozenset({"Cc", "Cs", "Zl", "Zp"})


class _Message(Struct, frozen=True, tag_field="type", tag=str.lower):
    """A JSON object sent over the socket; its field `type` names the class."""


class Keys(_Message, frozen=True):
    """The controls that are held, and the number of the newest frame on the page.

    The page sends one when a key changes and one for every frame, so that a lost message does no
    harm and the server knows that the page still responds.
    """

    held: Annotated[frozenset[Control], Meta(max_length=len(Control))]
    seen: FrameNumber


class Start(_Message, frozen=True):
    """Start an episode in an environment; without a seed, in a newly sampled scene."""

    env_id: str
    seed: Seed | None

    def __post_init__(self) -> None:
        force_setattr(self, "env_id", parse_env_id(self.env_id).without_preset)


class Restart(_Message, frozen=True):
    """Restart the episode in the same scene."""


class Pause(_Message, frozen=True):
    """Stop the clock until the next key."""


class Resume(_Message, frozen=True):
    """Start the clock again."""


class Show(_Message, frozen=True, tag="view"):
    """Render another view, one of `PAGE_VIEWS`."""

    view: ViewName


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


class Discard(_Message, frozen=True):
    """Drop the finished episode."""


class Watch(_Message, frozen=True):
    """Start an episode in which a policy acts until a key is pressed; `None`: without a policy."""

    policy: PolicyNumber | None


class HandBack(_Message, frozen=True, tag="hand_back"):
    """Let the policy continue after the player has taken over or paused it."""


Message = Keys | Start | Restart | Pause | Resume | Show | Keep | Discard | Watch | HandBack


class NoQuery(Struct, frozen=True):
    """A request without fields."""


class ListQuery(Struct, frozen=True):
    """A source's episodes, newest first: up to `PAGE_LENGTH` after the first `skip`."""

    source: SourceKey
    task: str  # empty: all tasks
    skip: Number

    def __post_init__(self) -> None:
        if self.task and self.task not in TASKS:  # generated tasks are, but are not listed
            raise ValueError(f"task: expected one of {', '.join(TASKS)}, found {quoted(self.task)}")


class EpisodeQuery(Struct, frozen=True):
    """One episode."""

    source: SourceKey
    episode: Number


class FramesQuery(EpisodeQuery, frozen=True):
    """Some frames of an episode."""

    view: ViewName
    first: Number
    count: Annotated[int, Meta(ge=1, le=MAX_FRAMES)]


class ProbabilitiesQuery(EpisodeQuery, frozen=True):
    """A policy's action probabilities in an episode."""

    policy: PolicyNumber


class RolloutRequest(Struct, frozen=True):
    """A new episode of a policy; without a seed, in a newly sampled scene."""

    policy: PolicyNumber
    env_id: str
    seed: Seed | None

    def __post_init__(self) -> None:
        force_setattr(self, "env_id", parse_env_id(self.env_id).without_preset)


_Record = TypeVar("_Record")
_DIGITS = re.compile("[0-9]{1,20}")


def parse_message(text: str) -> Message:
    """Parse a message; raises `MessageError` if it is invalid or too long."""
    content = bounded(text.encode(errors="replace"))
    message: Message = parse_json(content, Message, "message", MessageError)
    return message


def parse_query(kind: type[_Record], given: Mapping[str, str]) -> _Record:
    """Parse a query from URL parameters, without the token; raises `MessageError`."""
    plain = {name: int(text) if _DIGITS.fullmatch(text) else text for name, text in given.items()}
    return convert(plain, kind, "request", MessageError)


def bounded(content: bytes) -> bytes:
    """Return the content of a message or request; raises `MessageError` above `MAX_BYTES`."""
    if len(content) > MAX_BYTES:
        raise MessageError(f"message: expected at most {MAX_BYTES} bytes, found {len(content)}")
    return content
