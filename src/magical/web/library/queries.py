"""What the page may ask for over HTTP: every field is known, of one type and in a range."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from magical.envs.ids import EnvId
from magical.errors import MessageError
from magical.messages import quoted
from magical.tasks import TASKS
from magical.web.messages import checked_env_id, checked_integer, checked_seed, checked_view, read

MAX_KEY = 20  # characters of a source's key
MAX_NUMBER = 10**9  # of an episode
MAX_TEXT = 20  # characters of a number
MAX_FRAMES = 16  # in one answer
PAGE = 100  # episodes in one answer


@dataclass(frozen=True, slots=True)
class ListQuery:
    """Episodes of a source, newest first, `PAGE` of them after the first `skip`."""

    source: str
    task: str  # empty: of all tasks
    skip: int


@dataclass(frozen=True, slots=True)
class EpisodeQuery:
    """One episode."""

    source: str
    episode: int


@dataclass(frozen=True, slots=True)
class FramesQuery:
    """Some frames of an episode."""

    source: str
    episode: int
    view: str
    first: int
    count: int


@dataclass(frozen=True, slots=True)
class ProbabilitiesQuery:
    """A policy's action probabilities in an episode."""

    source: str
    episode: int
    policy: int


@dataclass(frozen=True, slots=True)
class RolloutRequest:
    """A new episode of a policy; without a seed, in a scene sampled anew."""

    policy: int
    env_id: EnvId
    seed: int | None


def _key(value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_KEY:
        raise MessageError(f"source: expected a key, found {quoted(value)}")
    return value


def _task(value: Any) -> str:
    if not isinstance(value, str) or value not in ("", *TASKS):
        raise MessageError(f"task: expected one of {', '.join(TASKS)}, found {quoted(value)}")
    return value


def _number(name: str, most: int = MAX_NUMBER, least: int = 0) -> Callable[[Any], int]:
    def check(value: Any) -> int:
        digits = isinstance(value, str) and value.isascii() and value.isdigit()
        if not digits or len(value) > MAX_TEXT or not least <= int(value) <= most:
            raise MessageError(
                f"{name}: expected an integer from {least} to {most}, found {quoted(value)}"
            )
        return int(value)

    return check


_EPISODE = {"source": _key, "episode": _number("episode")}
_FIELDS: Mapping[type, Mapping[str, Callable[[Any], Any]]] = {
    ListQuery: {"source": _key, "task": _task, "skip": _number("skip")},
    EpisodeQuery: _EPISODE,
    FramesQuery: {
        **_EPISODE,
        "view": checked_view,
        "first": _number("first"),
        "count": _number("count", MAX_FRAMES, 1),
    },
    ProbabilitiesQuery: {**_EPISODE, "policy": _number("policy")},
}

_Query = TypeVar("_Query")


def parse_query(kind: type[_Query], given: Mapping[str, str]) -> _Query:
    """A query from the fields of an address, without the token.

    Raises:
        MessageError: a field is missing, unknown or impossible.
    """
    return kind(**read(kind.__name__, given, _FIELDS[kind]))


def parse_rollout(content: Mapping[str, Any]) -> RolloutRequest:
    """A request for a rollout from JSON; raises `MessageError`."""
    checks = {
        "policy": lambda value: checked_integer("policy", value, MAX_NUMBER),
        "env_id": checked_env_id,
        "seed": checked_seed,
    }
    return RolloutRequest(**read("rollout", content, checks))
