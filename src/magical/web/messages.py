"""Messages from the page: JSON objects over the socket, checked before anything is done."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from magical.envs.ids import EnvId, parse_env_id
from magical.envs.keys import Control
from magical.envs.seeds import FIRST_EVALUATION_SEED
from magical.errors import MessageError, UnknownNameError
from magical.messages import quoted
from magical.scene.vocabulary import View
from magical.untrusted import check_plain

MAX_BYTES = 1024  # of a message
MAX_NAME = 100  # characters of a demonstrator's name
MAX_POLICY = 10**6  # the number of a policy
MAX_FRAME = 1 << 53  # the largest number of a frame: an integer that JavaScript can represent

VIEWS: Mapping[str, tuple[View, ...]] = MappingProxyType(
    {"allo": (View.ALLO,), "ego": (View.EGO,), "both": (View.EGO, View.ALLO)}
)


@dataclass(frozen=True, slots=True)
class Keys:
    """Which controls are held, and the number of the newest frame on the page.

    The page sends one when a key changes and one for every frame, so that one that is lost does no
    harm and the server knows that the page still answers.
    """

    held: frozenset[Control]
    seen: int


@dataclass(frozen=True, slots=True)
class Start:
    """Start an episode of an environment; without a seed, in a scene sampled anew."""

    env_id: EnvId
    seed: int | None


@dataclass(frozen=True, slots=True)
class Restart:
    """Start over in the same scene."""


@dataclass(frozen=True, slots=True)
class Pause:
    """Stop the clock until the next key."""


@dataclass(frozen=True, slots=True)
class Show:
    """Render another view, one of `VIEWS`."""

    view: str


@dataclass(frozen=True, slots=True)
class Keep:
    """Store the episode that has ended."""

    demonstrator: str


@dataclass(frozen=True, slots=True)
class Discard:
    """Drop the episode that has ended."""


@dataclass(frozen=True, slots=True)
class Watch:
    """Start an episode in which a policy acts until a key is pressed; `None`: play without one."""

    policy: int | None


@dataclass(frozen=True, slots=True)
class HandBack:
    """Let the policy go on that was taken over from, or paused."""


Message = Keys | Start | Restart | Pause | Show | Keep | Discard | Watch | HandBack


def parse_message(text: str) -> Message:
    """A message from its text.

    Raises:
        MessageError: it is none: too long, no JSON object, of an unknown type, or with missing,
            additional or impossible fields.
    """
    content = json_object(text)
    kind = content.pop("type", None)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise MessageError(f"type: expected one of {', '.join(_KINDS)}, found {quoted(kind)}")
    make, checks = _KINDS[kind]
    return make(**read(kind, content, checks))


def read(kind: str, content: Mapping[str, Any], checks: "_Checks") -> dict[str, Any]:
    """The checked fields of an object, which must be exactly those; raises `MessageError`."""
    if content.keys() != checks.keys():
        raise MessageError(f"{kind}: expected the fields {list(checks)}, found {quoted(content)}")
    return {name: check(content[name]) for name, check in checks.items()}


def json_object(text: str) -> dict[str, Any]:
    """A JSON object of at most `MAX_BYTES`; raises `MessageError`."""
    if len(text.encode(errors="replace")) > MAX_BYTES:
        raise MessageError(f"message: expected at most {MAX_BYTES} bytes, found {len(text)}")
    try:
        content = json.loads(text)
        check_plain(content)
    except (RecursionError, ValueError) as error:
        raise MessageError("message: expected JSON, found something else") from error
    if not isinstance(content, dict):
        raise MessageError(f"message: expected an object, found {quoted(content)}")
    return content


def _held(value: Any) -> frozenset[Control]:
    names = list(Control)
    if not isinstance(value, list) or len(value) > len(names):
        raise MessageError(f"held: expected a list of controls, found {quoted(value)}")
    if not all(isinstance(item, str) and item in names for item in value):
        raise MessageError(f"held: expected some of {', '.join(names)}, found {quoted(value)}")
    return frozenset(map(Control, value))


def _seen(value: Any) -> int:
    return checked_integer("seen", value, MAX_FRAME)


def checked_env_id(value: Any) -> EnvId:
    """An environment's id without a preset; raises `MessageError`."""
    if not isinstance(value, str):
        raise MessageError(f"env_id: expected an environment id, found {quoted(value)}")
    try:
        return parse_env_id(value).without_preset
    except UnknownNameError as error:
        raise MessageError(str(error)) from error


def checked_seed(value: Any) -> int | None:
    """A seed, or none; raises `MessageError`."""
    # Scenes of evaluation are not for demonstrations (docs/protocol.md).
    return None if value is None else checked_integer("seed", value, FIRST_EVALUATION_SEED - 1)


def checked_view(value: Any) -> str:
    """The name of one of `VIEWS`; raises `MessageError`."""
    if not isinstance(value, str) or value not in VIEWS:
        raise MessageError(f"view: expected one of {', '.join(VIEWS)}, found {quoted(value)}")
    return value


def _policy(value: Any) -> int | None:
    return None if value is None else checked_integer("policy", value, MAX_POLICY)


def _demonstrator(value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value.strip()) <= MAX_NAME:
        raise MessageError(
            f"demonstrator: expected a name of at most {MAX_NAME} characters, found {quoted(value)}"
        )
    if not value.strip().isprintable():
        raise MessageError(f"demonstrator: expected printable characters, found {quoted(value)}")
    return value.strip()


def checked_integer(name: str, value: Any, most: int) -> int:
    """An integer from 0 to `most`; raises `MessageError`."""
    if type(value) is not int or not 0 <= value <= most:
        raise MessageError(f"{name}: expected an integer from 0 to {most}, found {quoted(value)}")
    return value


_Checks = Mapping[str, Callable[[Any], Any]]
_KINDS: Mapping[str, tuple[Callable[..., Message], _Checks]] = MappingProxyType(
    {
        "keys": (Keys, {"held": _held, "seen": _seen}),
        "start": (Start, {"env_id": checked_env_id, "seed": checked_seed}),
        "restart": (Restart, {}),
        "pause": (Pause, {}),
        "view": (Show, {"view": checked_view}),
        "keep": (Keep, {"demonstrator": _demonstrator}),
        "discard": (Discard, {}),
        "watch": (Watch, {"policy": _policy}),
        "hand_back": (HandBack, {}),
    }
)


class RateLimit:
    """A token bucket: `rate` messages a second on average, `burst` at once."""

    def __init__(self, rate: float, burst: float, now: float) -> None:
        self.rate, self.burst = rate, burst
        self._available, self._updated = burst, now

    def allows(self, now: float) -> bool:
        """Whether one more message may be handled now, which then counts."""
        elapsed, self._updated = now - self._updated, now
        self._available = min(self.burst, self._available + elapsed * self.rate)
        if self._available < 1.0:
            return False
        self._available -= 1.0
        return True
