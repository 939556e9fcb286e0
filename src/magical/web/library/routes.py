"""The HTTP routes of the library. Slow work runs in threads, so that players need not wait."""

import asyncio
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

import numpy as np
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from magical.demos.trajectory import Actor
from magical.envs.ids import EnvId, parse_env_id
from magical.envs.keys import controls_of
from magical.envs.seeds import sample_training_seeds
from magical.errors import BusyError, MagicalError, MessageError, NotFoundError
from magical.scene.actions import ACTION_NAMES
from magical.tasks import Task, get_task
from magical.untrusted import parse_json
from magical.web.driver import episode_probabilities, roll_out
from magical.web.library.sources import (
    ROLLOUTS,
    DatasetSource,
    RolloutSource,
    summary,
    unique_names,
)
from magical.web.library.viewing import ViewedEpisode
from magical.web.messages import (
    PAGE_LENGTH,
    EpisodeQuery,
    FramesQuery,
    ListQuery,
    NoQuery,
    ProbabilitiesQuery,
    RolloutRequest,
    bounded,
    parse_query,
)
from magical.web.policies import Policies
from magical.web.security import RateLimit

REQUEST_RATE = 40.0  # requests per second, all pages together
REQUEST_BURST = 120.0  # requests
MAX_WAITING = 32  # requests running or queued, beyond which more are rejected
MAX_WAITING_ROLLOUTS = 4  # the same for rollouts and action probabilities, in their own queue
OPEN_EPISODES = 8  # kept in memory

_Result = TypeVar("_Result")
_Query = TypeVar("_Query")


class AsciiJSON(JSONResponse):
    """JSON with non-ASCII characters escaped: names in datasets may have lone surrogates."""

    def render(self, content: Any) -> bytes:
        """See Starlette."""
        return json.dumps(content, allow_nan=False).encode()


class Worker:
    """One thread with a bounded queue, so that a page cannot pile up work."""

    def __init__(self, name: str, limit: int) -> None:
        self._executor = ThreadPoolExecutor(1, name)
        self._free = limit

    async def run(self, work: Callable[..., _Result], *arguments: Any) -> _Result:
        """Run work in the thread and return its result; raises `BusyError` if the queue is full."""
        if not self._free:
            raise BusyError("the server is busy with other requests; try again in a moment")
        self._free -= 1
        future = asyncio.get_running_loop().run_in_executor(self._executor, work, *arguments)
        future.add_done_callback(self._note_done)  # also if the request was cancelled meanwhile
        return await future

    def _note_done(self, _: object) -> None:
        self._free += 1

    def close(self) -> None:
        """End the thread after its current work; queued work is cancelled."""
        self._executor.shutdown(wait=True, cancel_futures=True)


class Library:
    """A server's datasets, runs and rollouts, for the page's requests.

    Args:
        datasets: the datasets' folders; their keys are `d0`, `d1`, ...
        policies: the policies that can be rolled out.

    Raises:
        DatasetError: a folder holds no dataset, or a damaged one.
    """

    def __init__(self, datasets: Sequence[Path], policies: Policies) -> None:
        sources = map(DatasetSource, unique_names(datasets), datasets)
        self._rollouts = RolloutSource()
        self._sources = {f"d{i}": one for i, one in enumerate(sources)} | {ROLLOUTS: self._rollouts}
        self._policies = policies
        self._rng = np.random.default_rng()  # samples the seeds of scenes
        self._limit = RateLimit(REQUEST_RATE, REQUEST_BURST, monotonic())
        self._reader = Worker("reader", MAX_WAITING)  # reads files, renders frames
        self._runner = Worker("runner", MAX_WAITING_ROLLOUTS)  # runs policies
        self._opened = lru_cache(OPEN_EPISODES)(
            lambda source, number, _: ViewedEpisode(self._find(source).read(number))
        )

    def _viewed(self, source: str, number: int) -> ViewedEpisode:
        return self._opened(source, number, self._find(source).version)

    def routes(self) -> list[BaseRoute]:
        """All routes; none takes a file path from the request."""
        return [
            self._route("/api/library", NoQuery, self._reader, self._list_library),
            self._route("/api/episodes", ListQuery, self._reader, self._list_episodes),
            self._route("/api/episode", EpisodeQuery, self._reader, self._show_episode),
            self._route("/api/frames", FramesQuery, self._reader, self._send_frames),
            self._route(
                "/api/probabilities", ProbabilitiesQuery, self._runner, self._probabilities
            ),
            self._route("/api/rollouts", RolloutRequest, self._runner, self._roll_out, "POST"),
        ]

    def close(self) -> None:
        """End the threads."""
        self._reader.close()
        self._runner.close()

    def _route(
        self,
        path: str,
        kind: type[_Query],
        worker: Worker,
        answer: Callable[[_Query], Response],
        method: str = "GET",
    ) -> Route:
        """A route that limits the request rate and reports errors to the page."""

        async def respond(request: Request) -> Response:
            if not self._limit.allows(monotonic()):
                return _problem(429, "too many requests; try again in a moment")
            try:
                return await worker.run(answer, await _parsed(kind, request))
            except MagicalError as error:
                return _problem(_status(error), str(error))

        return Route(path, respond, methods=[method])

    def _find(self, key: str) -> DatasetSource | RolloutSource:
        if key not in self._sources:
            raise NotFoundError(f"source: expected one of {', '.join(self._sources)}")
        return self._sources[key]

    # Responses, computed in threads

    def _list_library(self, _: NoQuery) -> Response:
        return AsciiJSON(
            {
                "policies": [
                    {"number": i, "name": p.name, "tasks": p.tasks, "algorithm": p.algorithm}
                    for i, p in enumerate(self._policies.refresh())
                ],
                "tasks": [_described(get_task(name)) for name in self._policies.tasks],
                "sources": [{"key": k, "name": source.name} for k, source in self._sources.items()],
                "actions": [
                    {"name": name, "controls": controls_of(action)}
                    for action, name in enumerate(ACTION_NAMES)
                ],
                "actors": [actor.name.lower() for actor in Actor],
            }
        )

    def _list_episodes(self, query: ListQuery) -> Response:
        found = self._find(query.source).episodes().items()
        listed = [item for item in found if query.task in ("", item[1].env_id.task)]
        newest = listed[::-1][query.skip : query.skip + PAGE_LENGTH]
        return AsciiJSON({"total": len(listed), "episodes": [summary(*item) for item in newest]})

    def _show_episode(self, query: EpisodeQuery) -> Response:
        return AsciiJSON(self._viewed(query.source, query.episode).details)

    def _send_frames(self, query: FramesQuery) -> Response:
        viewed = self._viewed(query.source, query.episode)
        content = viewed.frames(query.view, query.first, query.count)
        return Response(content, media_type="application/octet-stream")

    def _probabilities(self, query: ProbabilitiesQuery) -> Response:
        policy = self._policies.load(query.policy)
        episode = self._find(query.source).read(query.episode)
        self._policies.find(query.policy).check(episode.env_id)
        return AsciiJSON(episode_probabilities(policy, episode).round(4).tolist())

    def _roll_out(self, wanted: RolloutRequest) -> Response:
        seed = sample_training_seeds(self._rng, 1)[0] if wanted.seed is None else wanted.seed
        episode = roll_out(self._policies, wanted.policy, parse_env_id(wanted.env_id), seed)
        return AsciiJSON({"source": ROLLOUTS, "episode": self._rollouts.add(episode)})


def _described(task: Task) -> dict[str, Any]:
    env_ids = {name: EnvId(task.name, name) for name in task.variants}
    return {"name": task.name, "summary": task.summary, "env_ids": env_ids}


async def _parsed(kind: type[_Query], request: Request) -> _Query:
    """Parse a request from its URL or its body; raises `MessageError`."""
    given = [item for item in request.query_params.multi_items() if item[0] != "token"]
    if len(dict(given)) < len(given):
        raise MessageError("expected each field once")
    if request.method != "POST":
        return parse_query(kind, dict(given))
    parse_query(NoQuery, dict(given))
    return parse_json(await body(request), kind, "request", MessageError)


async def body(request: Request) -> bytes:
    """A request's body, at most `MAX_BYTES`; raises `MessageError`."""
    content = b""
    try:
        async for part in request.stream():
            content = bounded(content + part)
    except ClientDisconnect as error:
        raise MessageError("body: the connection was closed before its end") from error
    return content


def _status(error: MagicalError) -> int:
    return {MessageError: 400, NotFoundError: 404, BusyError: 503}.get(type(error), 422)


def _problem(status: int, what: str) -> AsciiJSON:
    return AsciiJSON({"problem": what}, status_code=status)
